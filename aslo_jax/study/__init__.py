"""Studies: an experiment over thousands of samples of its parameters and noises."""

import importlib
from typing import TYPE_CHECKING, Any

from ._designs import DESIGNS as DESIGNS
from ._distributions import (
    AbstractDistribution as AbstractDistribution,
    Correlated as Correlated,
    Discrete as Discrete,
    LogNormal as LogNormal,
    Normal as Normal,
    Uniform as Uniform,
)
from ._run import open_study as open_study, run as run
from ._spread import Parameter as Parameter, Spread as Spread

if TYPE_CHECKING:
    from .._report import write_report as write_report
    from ._bound import Bound as Bound, cramer_rao as cramer_rao, with_bound as with_bound
    from ._comparison import compare as compare, ranking as ranking
    from ._influence import influences as influences
    from ._reference import bound_of as bound_of, unknown_in as unknown_in
    from ._rerun import Rerun as Rerun, rerun as rerun
    from ._sensitivity import slopes as slopes, sobol_indices as sobol_indices
    from ._statistics import quantile as quantile, summarise as summarise

__all__ = [
    "DESIGNS",
    "AbstractDistribution",
    "Bound",
    "Correlated",
    "Discrete",
    "LogNormal",
    "Normal",
    "Parameter",
    "Rerun",
    "Spread",
    "Uniform",
    "bound_of",
    "compare",
    "cramer_rao",
    "influences",
    "open_study",
    "quantile",
    "ranking",
    "rerun",
    "run",
    "slopes",
    "sobol_indices",
    "summarise",
    "unknown_in",
    "with_bound",
    "write_report",
]

# Evaluation needs scipy.stats, which is slow to import.
_LATER = {
    "Bound": "_bound",
    "cramer_rao": "_bound",
    "with_bound": "_bound",
    "bound_of": "_reference",
    "unknown_in": "_reference",
    "compare": "_comparison",
    "ranking": "_comparison",
    "influences": "_influence",
    "write_report": "._report",
    "Rerun": "_rerun",
    "rerun": "_rerun",
    "slopes": "_sensitivity",
    "sobol_indices": "_sensitivity",
    "quantile": "_statistics",
    "summarise": "_statistics",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(f".{_LATER[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LATER])
