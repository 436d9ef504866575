"""A function of arrays, compiled without a loop: in a fraction of the time that XLA takes
for a small one."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..._typing import PyTree
from .kept import ONE, kept, key_of, shape_of
from .program import Bodies, Program


def once(function: Callable[..., PyTree], *arguments: PyTree) -> PyTree:
    """`function(*arguments)` of trees whose arrays are concrete, by the fused engine; what
    is no array is static. `function` is one of a module, by which its program is kept.

    **Raises:** [`NotFusible`][] for what the engine cannot compile.
    """
    arrays, rest = eqx.partition(arguments, eqx.is_array)
    leaves, tree = jax.tree.flatten(arrays)
    leaves = [np.asarray(x) for x in leaves]
    shapes = [shape_of(x) for x in leaves]
    program, others = kept(
        key_of(rest, shapes, function, tree), lambda: _made(function, rest, tree, shapes)
    )
    _, final = program({"shared": leaves}, 1, 0)
    return eqx.combine(jax.tree.map(lambda x: x[0], final), others)


def _made(
    function: Callable[..., PyTree], rest: PyTree, tree: Any, shapes: list[Any]
) -> tuple[Program, PyTree]:
    """The program, and what the function returns besides arrays."""
    others: PyTree = None

    def found(leaves: list[Any]) -> PyTree:
        nonlocal others
        arguments = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
        arrays, others = eqx.partition(function(*arguments), eqx.is_array)
        return arrays

    bodies = Bodies(
        lambda inputs: ((), None),
        lambda k, carry, inputs: ((), None),
        lambda carry, inputs: found(inputs["shared"]),
    )
    program = Program.of(bodies, {"shared": shapes}, ONE)
    return program, others
