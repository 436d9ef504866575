"""Short vectors sorted by networks of comparators, in XLA's order: no number is last."""

from collections.abc import Callable, Iterator

import numpy as np

from .._ir.graph import Graph
from .elementwise import Unsupported, rule
from .values import Value, exceeds

COMPARATORS = 600  # the most of one vector


def merging(n: int) -> Iterator[tuple[int, int]]:
    """Pairs of places of Batcher's merge exchange sort."""
    p = 1
    while p < n:
        k = p
        while k >= 1:
            for j in range(k % p, n - k, 2 * k):
                for i in range(j, min(j + k, n - k)):
                    if i // (2 * p) == (i + k) // (2 * p):
                        yield i, i + k
            k //= 2
        p *= 2


def transposing(n: int) -> Iterator[tuple[int, int]]:
    """Pairs of places of odd-even transposition sort, which is stable: only neighbours are
    exchanged."""
    for turn in range(n):
        for i in range(turn % 2, n - 1, 2):
            yield i, i + 1


def _after(graph: Graph, one: list[int], other: list[int]) -> int:
    """Whether `one` follows `other` by the first key that differs."""
    out = exceeds(graph, one[-1], other[-1])
    for x, y in zip(one[-2::-1], other[-2::-1], strict=True):
        tied = graph.op("not", exceeds(graph, y, x))
        out = graph.op("or", exceeds(graph, x, y), graph.op("and", tied, out))
    return out


def _sorted(graph: Graph, columns: list[list[int]], keys: int, down: bool = False) -> None:
    """Sorts the columns in place by the first `keys` of them."""
    n = len(columns[0])
    pairs = list(merging(n) if len(columns) == 1 else transposing(n))
    if len(pairs) > COMPARATORS:
        raise Unsupported(
            f"it sorts {n} entries, which takes {len(pairs)} comparators, more than "
            f"{COMPARATORS}"
        )
    for i, j in pairs:
        first, second = ([column[k] for column in columns[:keys]] for k in (i, j))
        swap = _after(graph, *((second, first) if down else (first, second)))
        for column in columns:
            a, b = column[i], column[j]
            column[i], column[j] = graph.select(swap, b, a), graph.select(swap, a, b)


def _sort(graph, equation, *operands):
    p = equation.params
    operands = [np.moveaxis(x.copy(), p["dimension"], -1) for x in operands]
    for at in np.ndindex(operands[0].shape[:-1]):
        columns = [x[at].tolist() for x in operands]
        _sorted(graph, columns, p["num_keys"])
        for x, column in zip(operands, columns, strict=True):
            x[at] = column
    return [np.moveaxis(x, -1, p["dimension"]) for x in operands]


def _top_k(graph, equation, x):
    p = equation.params
    axis, dtype = p.get("axis", p.get("dimension", -1)), equation.outvars[1].aval.dtype
    x = np.moveaxis(x.copy(), axis, -1)
    places: Value = np.empty(x.shape, np.int64)
    for at in np.ndindex(x.shape[:-1]):
        columns = [x[at].tolist(), [graph.const(k, dtype) for k in range(x.shape[-1])]]
        _sorted(graph, columns, 1, down=True)
        x[at], places[at] = columns
    return [np.moveaxis(y[..., : p["k"]], -1, axis) for y in (x, places)]


@rule("lt_to")
def _precedes(graph, dtype, params, x, y):
    return exceeds(graph, y, x)


@rule("le_to")
def _does_not_follow(graph, dtype, params, x, y):
    return graph.op("not", exceeds(graph, x, y))


SORTING: dict[str, Callable] = {"sort": _sort, "top_k": _top_k}
