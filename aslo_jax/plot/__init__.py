"""Figures: estimates beside the truth, their errors, studies, tuning, calibration.

Every function draws into a figure or axes that are given, or into a new figure, and returns
the figure of matplotlib; `figure.savefig("name.pdf")` writes it. A figure that is made here
has a style of its own, whatever the global one is, and neither changes that nor is known to
pyplot. Importing this module does not import matplotlib, which the extra `plot` brings.
"""

from typing import TYPE_CHECKING

from .._lazy import lazily as _lazily

if TYPE_CHECKING:
    from ._calibration import calibration as calibration
    from ._estimates import error as error, estimate as estimate
    from ._studies import bands as bands, ranking as ranking
    from ._tuning import front as front, landscape as landscape, tuning as tuning

__all__ = [
    "bands",
    "calibration",
    "error",
    "estimate",
    "front",
    "landscape",
    "ranking",
    "tuning",
]

__getattr__, __dir__ = _lazily(
    __name__,
    {
        "_calibration": ("calibration",),
        "_estimates": ("error", "estimate"),
        "_studies": ("bands", "ranking"),
        "_tuning": ("front", "landscape", "tuning"),
    },
)
