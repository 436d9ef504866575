"""Values, arrays of node numbers, and what the rules for arrays share."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .._ir.graph import Graph
from .elementwise import ELEMENTWISE

Value = np.ndarray  # of node numbers


def constant(graph: Graph, x: Any) -> Value:
    """An array of constants; typed random keys must be raw ones."""
    x = np.asarray(x)
    numbers = np.empty(x.shape, np.int64)
    for index in np.ndindex(x.shape):
        numbers[index] = graph.const(x[index], x.dtype)
    return numbers


def known(graph: Graph, value: Value) -> np.ndarray | None:
    """The array behind `value`, if every entry is a constant."""
    numbers = np.asarray(value).flatten().tolist()
    found = [graph.value(n) for n in numbers]
    if any(v is None for v in found):
        return None
    dtype = graph.dtype(numbers[0]) if numbers else np.int64
    return np.array(found, dtype).reshape(np.shape(value))


def array(rule: Callable) -> Callable:
    """A rule that returns one array."""

    def applied(*arguments):
        return [rule(*arguments)]

    return applied


def select(graph: Graph, which: int, on_true: Value, on_false: Value) -> Value:
    out = np.empty(on_true.shape, np.int64)
    for index in np.ndindex(out.shape):
        out[index] = graph.select(which, int(on_true[index]), int(on_false[index]))
    return out


def neutral(name: str, dtype: Any) -> Any:
    """What changes nothing under an operation."""
    dtype = np.dtype(dtype)
    if name in ("max", "min"):
        if dtype.kind == "f":
            return -np.inf if name == "max" else np.inf
        if dtype.kind == "b":
            return name == "min"
        info = np.iinfo(dtype)
        return info.min if name == "max" else info.max
    if name == "and":
        return np.invert(dtype.type(0))
    return {"add": 0, "mul": 1, "or": 0, "xor": 0}[name]


def fold(graph: Graph, name: str, dtype: Any, numbers: np.ndarray) -> int:
    """A balanced tree of an operation over `numbers`."""
    left = [int(n) for n in numbers]
    if not left:
        return graph.const(neutral(name, dtype), dtype)
    rule = ELEMENTWISE[name]
    while len(left) > 1:
        pairs = [
            rule(graph, dtype, {}, *left[k : k + 2]) for k in range(0, len(left) - 1, 2)
        ]
        left = pairs + ([left[-1]] if len(left) % 2 else [])
    return left[0]


def exceeds(graph: Graph, x: int, y: int) -> int:
    """Whether x follows y in the order of XLA's sorting: no number is the largest."""
    if graph.dtype(x).kind != "f":
        return graph.op("gt", x, y)
    return graph.op("and", graph.op("not", graph.op("le", x, y)), graph.op("eq", y, y))
