"""Products of large matrices, and functions of many entries, as operations that a kernel
does in loops: so many scalar ones would take long to compile, and be read from memory again
in each step."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from .._ir.goal import Goal
from .._ir.graph import Function, Graph

SHORT = 4  # no sum of so few products takes a loop


def is_large(graph: Graph, rows: int, columns: int, inner: int) -> bool:
    """Whether a product of two matrices is one of loops."""
    return inner > SHORT and rows * columns * inner >= graph.goal.large


def product(graph: Graph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of matrices of real numbers of one type, shapes (m, k) and (n, k), that of each row
    of one with each of the other. The rows of the longer one are done in one loop."""
    longer, other = (a, b) if len(a) >= len(b) else (b, a)
    out = np.empty((len(longer), len(other)), np.int64)
    for j, vector in enumerate(other.tolist()):
        for i, row in enumerate(longer.tolist()):
            out[i, j] = graph.dot(*row, *vector)
    return out if longer is a else out.T


def entrywise(
    graph: Graph,
    rule: Callable[..., int],
    dtype: Any,
    params: Any,
    arguments: Sequence[np.ndarray],
) -> np.ndarray | None:
    """A rule on every entry of arrays of one shape, as calls of a function; `None` where
    that is not worth a loop."""
    if arguments[0].size < graph.goal.many or any(
        graph.dtype(int(n)) != dtype for a in arguments for n in a.flat[:1]
    ):
        return None
    functions: dict[Any, Function] = {}
    goal, many = graph.goal, arguments[0].size
    out = np.empty(arguments[0].shape, np.int64)
    for index, args in _entries(arguments):
        values = [graph.value(n) for n in args]
        key = tuple(None if v is None else v.tobytes() for v in values)
        if key not in functions:
            made = functions[key] = _function(goal, rule, dtype, params, values)
            size = made.graph.size(made.result)
            if made.graph.dtype(made.result) != dtype or size * many < goal.large:
                return None
        free = [n for n, v in zip(args, values, strict=True) if v is None]
        out[index] = graph.call(functions[key], *free)
    return out


def _entries(arguments: Sequence[np.ndarray]) -> Iterator[tuple[Any, list[int]]]:
    for index in np.ndindex(arguments[0].shape):
        yield index, [int(a[index]) for a in arguments]


def _function(
    goal: Goal, rule: Callable[..., int], dtype: Any, params: Any, values: list[Any]
) -> Function:
    """A rule as a function of the arguments that are not known."""
    graph, given = Graph(goal), []
    for value in values:
        if value is None:
            place = sum(graph.value(n) is None for n in given)
            given.append(graph.input(dtype, ("argument", place)))
        else:
            given.append(graph.const(value, value.dtype))
    return Function(graph, rule(graph, dtype, params, *given))
