"""Loops along a log in the fused engine, whose programs are kept."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax

if TYPE_CHECKING:
    from ...engines._fused.program import Bodies

DROP = {"shared": 0, "log": 1, "lane": 1, "lane log": 2}  # axes in front of one sample


def run_kept(
    key: tuple[Any, ...], bodies: "Callable[[], Bodies]", inputs: dict, lanes: int
) -> tuple[Any, Any]:
    """The records and what is final of a loop over the rows of the `log` of its `inputs`,
    by kind; `key` and the shapes of the inputs tell one program from another.

    **Raises:** [`NotFusible`][] for what the engine cannot compile."""
    from ...engines._fused.kept import kept, key_of, shape_of  # which need an extra
    from ...engines._fused.program import Program
    from ...engines._runtime.host import widths

    shapes = {
        kind: jax.tree.map(lambda x, n=DROP[kind]: shape_of(x, n), tree)
        for kind, tree in inputs.items()
    }
    rest, *more = key
    made = lambda: Program.of(bodies(), shapes, widths())
    program = kept(key_of(rest, shapes, *more), made)
    steps = len(jax.tree.leaves(inputs["log"])[0])
    return program(inputs, lanes, steps)
