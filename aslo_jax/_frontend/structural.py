"""Structural primitives of JAX, which move entries, and those that combine a few of them.

A value is an array of node numbers. A rule gets the graph, the equation and the values, and
returns a list of values.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from .._ir.graph import Graph
from .factorisations import FACTORISATIONS
from .indexing import INDEXING
from .large import is_large, product
from .reductions import REDUCTIONS, spaced
from .sorting import SORTING
from .values import Value, array, constant, fold, known, select

__all__ = ["STRUCTURAL", "Value", "constant", "known", "select"]


def _broadcast_in_dim(graph, equation, x, *sizes):
    shape = equation.params["shape"]
    place = [1] * len(shape)
    for axis, dimension in enumerate(equation.params["broadcast_dimensions"]):
        place[dimension] = x.shape[axis]
    return np.broadcast_to(x.reshape(place), shape)


def _slice(graph, equation, x):
    p = equation.params
    strides = p["strides"] or (1,) * x.ndim
    bounds = zip(p["start_indices"], p["limit_indices"], strides, strict=True)
    return x[tuple(slice(a, b, s) for a, b, s in bounds)]


def _pad(graph, equation, x, filling):
    return spaced(x, int(filling), equation.params["padding_config"])


def _iota(graph, equation, *sizes):
    aval = equation.outvars[0].aval
    axis = equation.params["dimension"]
    place = [1] * len(aval.shape)
    place[axis] = -1
    numbers = np.arange(aval.shape[axis]).reshape(place)
    return constant(graph, np.broadcast_to(numbers, aval.shape).astype(aval.dtype))


def _dot_general(graph, equation, a, b):
    (ca, cb), (ba, bb) = equation.params["dimension_numbers"]
    dtype = equation.outvars[0].aval.dtype
    fa = [k for k in range(a.ndim) if k not in (*ca, *ba)]
    fb = [k for k in range(b.ndim) if k not in (*cb, *bb)]
    batch = [a.shape[k] for k in ba]
    A = np.transpose(a, (*ba, *fa, *ca)).reshape(*batch, -1, _size(a, ca))
    B = np.transpose(b, (*bb, *fb, *cb)).reshape(*batch, -1, _size(b, cb))
    out = np.empty((*batch, A.shape[-2], B.shape[-2]), np.int64)
    if dtype.kind == "f" and is_large(graph, *out.shape[-2:], A.shape[-1]):
        A, B = (_converted(graph, x, dtype) for x in (A, B))
        for at in np.ndindex(*batch):
            out[at] = product(graph, A[at], B[at])
        return out.reshape(equation.outvars[0].aval.shape)
    for index in np.ndindex(out.shape):
        *at, i, j = index
        rows = (A[(*at, i)], B[(*at, j)])  # which may be of two types
        one, two = ([graph.convert(int(n), dtype) for n in row] for row in rows)
        products = [graph.op("mul", x, y) for x, y in zip(one, two, strict=True)]
        out[index] = fold(graph, "add", dtype, np.array(products))
    return out.reshape(equation.outvars[0].aval.shape)


def _converted(graph: Graph, x: Value, dtype: Any) -> Value:
    numbers = [graph.convert(n, dtype) for n in x.flatten().tolist()]
    return np.array(numbers, np.int64).reshape(x.shape)


def _size(x: Value, axes: Any) -> int:
    return int(np.prod([x.shape[k] for k in axes], dtype=int))


STRUCTURAL: dict[str, Callable] = {
    **INDEXING,
    **REDUCTIONS,
    **SORTING,
    **FACTORISATIONS,
    "broadcast_in_dim": array(_broadcast_in_dim),
    "reshape": array(lambda g, e, x, *s: x.reshape(e.params["new_sizes"])),
    "squeeze": array(lambda g, e, x: np.squeeze(x, tuple(e.params["dimensions"]))),
    "expand_dims": array(lambda g, e, x: np.expand_dims(x, e.params["dimensions"])),
    "transpose": array(lambda g, e, x: np.transpose(x, e.params["permutation"])),
    "rev": array(lambda g, e, x: np.flip(x, e.params["dimensions"])),
    "concatenate": array(lambda g, e, *xs: np.concatenate(xs, e.params["dimension"])),
    "stack": array(lambda g, e, *xs: np.stack(xs, e.params.get("axis", 0))),
    "tile": array(lambda g, e, x: np.tile(x, e.params["reps"])),
    "slice": array(_slice),
    "pad": array(_pad),
    "iota": array(_iota),
    "dot_general": array(_dot_general),
    "split": lambda g, e, x: np.split(
        x, np.cumsum(e.params["sizes"])[:-1], e.params["axis"]
    ),
    "unstack": lambda g, e, x: [
        np.take(x, [k], e.params["axis"]).squeeze(e.params["axis"])
        for k in range(x.shape[e.params["axis"]])
    ],
    "optimization_barrier": lambda g, e, *xs: list(xs),
}
