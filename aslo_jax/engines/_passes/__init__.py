"""Passes over a loop, one in a file, each from a loop to one with the same results.

`PASSES` are the pipeline, in their order; what each is worth is measured by
`python -m benchmarks ablation`.
"""

from collections.abc import Callable, Collection
from typing import NamedTuple

from ..._ir.loop import Loop
from ..._ir.rewrite import pruned
from .commoning import kept
from .congruence import merged
from .correlated import decided
from .factors import factored
from .quotients import undivided
from .timetable import timetabled
from .unswitching import unswitched


class Pass(NamedTuple):
    name: str
    run: Callable[[Loop], Loop]


PASSES = (
    Pass("congruence", merged),
    Pass("commoning", kept),
    Pass("congruence", merged),
    Pass("correlation", decided),
    Pass("quotients", undivided),
    Pass("factors", factored),
    Pass("timetable", timetabled),
    Pass("unswitching", unswitched),
)


def _nothing(name: str, loop: Loop) -> None:
    pass


CHECK: Callable[[str, Loop], None] = _nothing  # the tests set `ir.verifier` here


def optimised(
    loop: Loop,
    *,
    without: Collection[str] = (),
    seen: Callable[[str, Loop], None] | None = None,
) -> Loop:
    """The loop after all passes but those `without`. `seen` gets the name of each and the
    loop that it leaves: to print it ([`Loop.listing`][])."""
    seen = CHECK if seen is None else seen
    seen("given", loop)
    for each in PASSES:
        if each.name not in without:
            loop = pruned(each.run(loop))
            seen(each.name, loop)
    return loop
