"""Factorisations and triangular systems of small matrices in straight-line code, with the
pivots of LAPACK."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .._ir.graph import Graph
from .elementwise import Unsupported
from .values import Value, array, constant, select

LARGEST = 6  # the most rows, and columns


def _bearable(*shape: int) -> None:
    if max(shape, default=0) > LARGEST:
        size = " by ".join(map(str, shape))
        raise Unsupported(f"its matrix is {size}, larger than {LARGEST} by {LARGEST}")


def _without(graph: Graph, x: int, products: list[tuple[int, int]]) -> int:
    """`x` less a sum of products."""
    for pair in products:
        x = graph.op("sub", x, graph.op("mul", *map(int, pair)))
    return x


def _inverse(graph: Graph, x: int) -> int:
    return graph.op("div", graph.const(1, graph.dtype(x)), x)


def _lu_of(graph: Graph, a: Value, whole: Any) -> tuple[Value, Value, Value]:
    """`L` below the diagonal and `U`, the row that each pivot came from, and the order of
    the rows: Gaussian elimination with partial pivoting, rows exchanged by selects."""
    a = a.copy()
    m, n = a.shape
    rows = constant(graph, np.arange(m, dtype=whole))
    pivots = constant(graph, np.arange(min(m, n), dtype=whole))
    for k in range(min(m, n)):
        # The first of the largest, row k so far.
        best = graph.op("abs", int(a[k, k]))
        larger = []
        for i in range(k + 1, m):
            size = graph.op("abs", int(a[i, k]))
            larger.append(graph.op("gt", size, best))
            best = graph.select(larger[-1], size, best)
        top, place, name = a[k], pivots[k], rows[k]
        old, old_name = top, name
        later = graph.const(False, bool)
        chosen = []  # whether row i is the pivot's, from the last one
        for better in reversed(larger):
            chosen.append(graph.op("and", better, graph.op("not", later)))
            later = graph.op("or", later, better)
        for i, here in zip(range(k + 1, m), reversed(chosen), strict=True):
            top = select(graph, here, a[i], top)
            place = graph.select(here, graph.const(i, whole), int(place))
            name = graph.select(here, int(rows[i]), int(name))
            a[i] = select(graph, here, old, a[i])
            rows[i] = graph.select(here, int(old_name), int(rows[i]))
        a[k], pivots[k], rows[k] = top, place, name
        pivot = int(a[k, k])
        # Below a pivot of zero are zeros, which stay.
        absent = graph.op("eq", pivot, graph.const(0, graph.dtype(pivot)))
        inverse = _inverse(graph, pivot)
        for i in range(k + 1, m):
            ratio = graph.op("mul", int(a[i, k]), inverse)
            a[i, k] = graph.select(absent, int(a[i, k]), ratio)
            for j in range(k + 1, n):
                a[i, j] = _without(graph, int(a[i, j]), [(a[i, k], a[k, j])])
    return a, pivots, rows


def _lu(graph, equation, a):
    _bearable(*a.shape[-2:])
    avals = [v.aval for v in equation.outvars]
    out = [np.empty(aval.shape, np.int64) for aval in avals]
    for at in np.ndindex(a.shape[:-2]):
        for x, found in zip(out, _lu_of(graph, a[at], avals[1].dtype), strict=True):
            x[at] = found
    return out


def _permutation(graph, equation, pivots):
    """The order of rows after exchanges of one after the other."""
    aval = equation.outvars[0].aval
    size = aval.shape[-1]
    _bearable(size)
    out = np.empty(aval.shape, np.int64)
    for at in np.ndindex(aval.shape[:-1]):
        rows = constant(graph, np.arange(size, dtype=aval.dtype))
        for k, pivot in enumerate(pivots[at].tolist()):
            old, top = int(rows[k]), int(rows[k])
            for i in range(size):
                here = graph.op("eq", pivot, graph.const(i, graph.dtype(pivot)))
                top = graph.select(here, int(rows[i]), top)
                rows[i] = graph.select(here, old, int(rows[i]))
            rows[k] = top
        out[at] = rows
    return out


def _cholesky(graph, equation, a):
    """Of what is on and below the diagonal. No number at all where the matrix is not
    positive definite; where an entry is not a number, none from its row on, as from
    LAPACK, to which a pivot that is not a number is none below zero."""
    _bearable(*a.shape[-2:])
    dtype = equation.outvars[0].aval.dtype
    out = np.full(a.shape, graph.const(0, dtype), np.int64)
    nothing = np.full(a.shape[-2:], graph.const(np.nan, dtype))
    for at in np.ndindex(a.shape[:-2]):
        L, definite = out[at], graph.const(True, bool)
        for j in range(a.shape[-1]):
            pivot = _without(graph, int(a[at][j, j]), [(x, x) for x in L[j, :j]])
            negative = graph.op("le", pivot, graph.const(0, dtype))
            definite = graph.op("and", definite, graph.op("not", negative))
            L[j, j] = graph.op("sqrt", pivot)
            inverse = _inverse(graph, int(L[j, j]))
            for i in range(j + 1, a.shape[-1]):
                pairs = list(zip(L[i, :j], L[j, :j], strict=True))
                left = _without(graph, int(a[at][i, j]), pairs)
                L[i, j] = graph.op("mul", left, inverse)
        out[at] = select(graph, definite, L, nothing)
    return out


def _triangular_solve(graph, equation, a, b):
    p = equation.params
    _bearable(*a.shape[-2:])
    out, lower = b.copy(), p["lower"]
    if p["transpose_a"]:
        a, lower = np.swapaxes(a, -1, -2), not lower
    if not p["left_side"]:  # x a = b
        a, out, lower = np.swapaxes(a, -1, -2), np.swapaxes(out, -1, -2), not lower
    n = a.shape[-1]
    order = list(range(n) if lower else reversed(range(n)))
    for at in np.ndindex(a.shape[:-2]):
        matrix, x = a[at], out[at]
        for turn, i in enumerate(order):
            inverse = None if p["unit_diagonal"] else _inverse(graph, int(matrix[i, i]))
            for j in range(x.shape[-1]):
                pairs = [(matrix[i, k], x[k, j]) for k in order[:turn]]
                left = _without(graph, int(x[i, j]), pairs)
                x[i, j] = left if inverse is None else graph.op("mul", left, inverse)
    return out if p["left_side"] else np.swapaxes(out, -1, -2)


FACTORISATIONS: dict[str, Callable] = {
    "lu": _lu,
    "lu_pivots_to_permutation": array(_permutation),
    "cholesky": array(_cholesky),
    "triangular_solve": array(_triangular_solve),
}
