"""Functions of the entries of vectors that are meant for one loop in machine code: a sum of
many vectors, say, each with a weight."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from .._ir.graph import Function, Graph

NAME = "aslo_jax_entrywise"  # of a `jax.jit`


def entrywise(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of vectors of one length, and of numbers, by whose every entry it gives an
    entry of its result: in machine code a loop, where there are many."""

    def named(*arguments: Any) -> Any:
        return function(*arguments)

    named.__name__ = NAME
    return jax.jit(named)


def is_entrywise(equation: Any) -> bool:
    return equation.params.get("name", "") == NAME


def looped(
    graph: Graph,
    inline: Callable[[Graph, list[Any]], list[Any]],
    arguments: Sequence[np.ndarray],
) -> list[np.ndarray] | None:
    """Calls of the function, which `inline` puts into another graph; `None` where that is
    not worth a loop."""
    size = max(array.size for array in arguments)
    if size < graph.goal.entries or any(a.size not in (1, size) for a in arguments):
        return None
    types = {graph.dtype(int(n)) for array in arguments for n in array.flat}
    if len(types) > 1 or next(iter(types)).kind != "f":
        return None
    dtype, inner = types.pop(), Graph(graph.goal)
    given = [
        np.full(array.shape, inner.input(dtype, ("argument", k)), np.int64)
        for k, array in enumerate(arguments)
    ]
    (found,) = (np.asarray(x) for x in inline(inner, given))
    results = {int(n) for n in found.flat}
    if len(results) > 1 or inner.dtype(int(found.flat[0])) != dtype:
        return None
    function = Function(inner, results.pop())
    flat = [np.broadcast_to(a.reshape(-1), size).tolist() for a in arguments]
    calls = [graph.call(function, *each) for each in zip(*flat, strict=True)]
    return [np.array(calls, np.int64).reshape(found.shape)]
