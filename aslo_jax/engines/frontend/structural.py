"""Structural primitives of JAX, which move entries, and those that combine a few of them.

A value is an array of node numbers. A rule gets the graph, the equation and the values, and
returns a list of values.
"""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..ir.graph import Graph
from .elementwise import ELEMENTWISE, Unsupported
from .large import is_large, product

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


def _array(rule: Callable) -> Callable:
    """A rule that returns one array."""

    def applied(graph, equation, *arguments):
        return [rule(graph, equation, *arguments)]

    return applied


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
    out = x
    for axis, (low, high, interior) in enumerate(equation.params["padding_config"]):
        out = np.moveaxis(out, axis, 0)
        count = len(out)
        if interior and count:
            wide = np.full((count + (count - 1) * interior, *out.shape[1:]), filling)
            wide[:: interior + 1] = out
            out = wide
        ends = [np.full((max(n, 0), *out.shape[1:]), filling) for n in (low, high)]
        out = np.concatenate([ends[0], out, ends[1]])
        out = out[max(-low, 0) : len(out) - max(-high, 0)]
        out = np.moveaxis(out, 0, axis)
    return out


def _iota(graph, equation, *sizes):
    aval = equation.outvars[0].aval
    axis = equation.params["dimension"]
    place = [1] * len(aval.shape)
    place[axis] = -1
    numbers = np.arange(aval.shape[axis]).reshape(place)
    return constant(graph, np.broadcast_to(numbers, aval.shape).astype(aval.dtype))


def _starts(graph, x, indices, sizes):
    starts = []
    for index, count, size in zip(indices, x.shape, sizes, strict=True):
        place = known(graph, np.asarray(index))
        if place is None:
            raise Unsupported("its index is not known when it is traced")
        starts.append(int(np.clip(int(place), 0, count - size)))
    return starts


def _dynamic_slice(graph, equation, x, *indices):
    sizes = equation.params["slice_sizes"]
    if any(known(graph, np.asarray(i)) is None for i in indices):
        return _selected(graph, x, indices, sizes)
    starts = _starts(graph, x, indices, sizes)
    return x[tuple(slice(a, a + s) for a, s in zip(starts, sizes, strict=True))]


def _selected(graph, x, indices, sizes):
    """A slice at an index that varies: one select for each place that it can have."""
    ranges = [range(n - s + 1) for n, s in zip(x.shape, sizes, strict=True)]
    places = list(itertools.product(*ranges))
    if len(places) > 64:
        table = known(graph, x)
        if table is None:
            raise Unsupported(
                f"its index varies over {len(places)} places, more than 64, of an array "
                "that is not constant"
            )
        return _read(graph, table, indices, sizes)
    out = None
    for place in reversed(places):
        piece = x[tuple(slice(a, a + s) for a, s in zip(place, sizes, strict=True))]
        if out is None:
            out = piece
            continue
        here = graph.const(True, bool)
        for index, at, span in zip(indices, place, ranges, strict=True):
            if len(span) > 1:
                number = int(np.asarray(index).reshape(()))
                bound = graph.const(at, graph.dtype(number))
                op = "le" if at == 0 else "eq"
                here = graph.op("and", here, graph.op(op, number, bound))
        out = select(graph, here, piece, out)
    return out


def _read(graph, table, indices, sizes):
    """A slice of constants at an index that varies: a log, a reference."""
    number = graph.const(0, np.int64)
    strides = np.cumprod([1, *table.shape[:0:-1]])[::-1]
    for index, count, size, stride in zip(
        indices, table.shape, sizes, strides, strict=True
    ):
        start = graph.convert(int(np.asarray(index).reshape(())), np.int64)
        for op, bound in (("lt", 0), ("gt", count - size)):
            limit = graph.const(bound, np.int64)
            start = graph.select(graph.op(op, start, limit), limit, start)
        start = graph.op("mul", start, graph.const(int(stride), np.int64))
        number = graph.op("add", number, start)
    out = np.empty(sizes, np.int64)
    for index in np.ndindex(out.shape):
        further = graph.const(int(np.dot(index, strides)), np.int64)
        place = graph.op("add", number, further)
        out[index] = graph.table(table.reshape(-1), place)
    return out


def select(graph: Graph, which: int, on_true: Value, on_false: Value) -> Value:
    out = np.empty(on_true.shape, np.int64)
    for index in np.ndindex(out.shape):
        out[index] = graph.select(which, int(on_true[index]), int(on_false[index]))
    return out


def _dynamic_update_slice(graph, equation, x, update, *indices):
    starts = _starts(graph, x, indices, update.shape)
    out = x.copy()
    places = zip(starts, update.shape, strict=True)
    out[tuple(slice(a, a + s) for a, s in places)] = update
    return out


def _by_position(graph, equation, *arguments):
    """gather and scatter with known indices: the primitive itself moves the numbers."""
    moved, rest = list(arguments), {}
    for k, argument in enumerate(arguments):
        if k == 1:
            rest[k] = known(graph, argument)
            if rest[k] is None:
                raise Unsupported("its indices are not known when it is traced")
    params = dict(equation.params)
    filling = {"fill_value": -1} if "fill_value" in params else {}
    with jax.ensure_compile_time_eval():
        operands = [jnp.asarray(rest.get(k, moved[k])) for k in range(len(moved))]
        found = np.asarray(equation.primitive.bind(*operands, **(params | filling)))
    if (found < 0).any():
        raise Unsupported("it reads beyond its operand")
    return found.astype(np.int64)


def _scatter_add(graph, equation, x, indices, updates):
    places = known(graph, indices)
    if places is None:
        raise Unsupported("its indices are not known when it is traced")
    out = x.copy().reshape(-1)
    zero = jnp.zeros(x.shape, equation.outvars[0].aval.dtype)
    for k in range(updates.size):  # one update at a time, since they may coincide
        one = jnp.zeros(updates.size, zero.dtype).at[k].set(1).reshape(updates.shape)
        with jax.ensure_compile_time_eval():
            hit = equation.primitive.bind(zero, jnp.asarray(places), one, **equation.params)
        for position in np.flatnonzero(np.asarray(hit).reshape(-1)):
            out[position] = graph.op("add", int(out[position]), int(updates.flat[k]))
    return out.reshape(x.shape)


def _reduction(name: str) -> Callable:
    def rule(graph, equation, x):
        axes = equation.params["axes"]
        out_aval = equation.outvars[0].aval
        kept = [a for a in range(x.ndim) if a not in axes]
        rows = np.transpose(x, (*kept, *axes)).reshape(*out_aval.shape, -1)
        out = np.empty(out_aval.shape, np.int64)
        for index in np.ndindex(out.shape):
            out[index] = fold(graph, name, out_aval.dtype, rows[index])
        return out

    return rule


NEUTRAL = {"add": 0, "mul": 1, "and": True, "or": False}


def fold(graph: Graph, name: str, dtype: Any, numbers: np.ndarray) -> int:
    """A balanced tree of an operation over `numbers`."""
    left = [int(n) for n in numbers]
    if not left:
        return graph.const(NEUTRAL[name], dtype)
    rule = ELEMENTWISE[name]
    while len(left) > 1:
        pairs = [
            rule(graph, dtype, {}, *left[k : k + 2]) for k in range(0, len(left) - 1, 2)
        ]
        left = pairs + ([left[-1]] if len(left) % 2 else [])
    return left[0]


def _dot_general(graph, equation, a, b):
    (ca, cb), (ba, bb) = equation.params["dimension_numbers"]
    dtype = equation.outvars[0].aval.dtype
    fa = [k for k in range(a.ndim) if k not in (*ca, *ba)]
    fb = [k for k in range(b.ndim) if k not in (*cb, *bb)]
    batch = [a.shape[k] for k in ba]
    A = np.transpose(a, (*ba, *fa, *ca)).reshape(*batch, -1, _size(a, ca))
    B = np.transpose(b, (*bb, *fb, *cb)).reshape(*batch, -1, _size(b, cb))
    out = np.empty((*batch, A.shape[-2], B.shape[-2]), np.int64)
    if dtype.kind == "f" and is_large(*out.shape[-2:], A.shape[-1]):
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


def _cumulative(name: str) -> Callable:
    def rule(graph, equation, x):
        axis, reverse = equation.params["axis"], equation.params["reverse"]
        out = np.moveaxis(x.copy(), axis, 0)
        out = out[::-1] if reverse else out
        for k in range(1, len(out)):
            for index in np.ndindex(out.shape[1:]):
                pair = int(out[k - 1][index]), int(out[k][index])
                out[k][index] = ELEMENTWISE[name](graph, graph.dtype(pair[0]), {}, *pair)
        return np.moveaxis(out[::-1] if reverse else out, 0, axis)

    return rule


def _argument(op: str) -> Callable:
    def rule(graph, equation, x):
        (axis,) = equation.params["axes"]
        dtype = equation.outvars[0].aval.dtype
        rows = np.moveaxis(x, axis, 0)
        out = np.empty(rows.shape[1:], np.int64)
        for index in np.ndindex(out.shape):
            best, place = int(rows[0][index]), graph.const(0, dtype)
            for k in range(1, len(rows)):
                other = int(rows[k][index])
                better = graph.op(op, other, best)
                best = graph.select(better, other, best)
                place = graph.select(better, graph.const(k, dtype), place)
            out[index] = place
        return out

    return rule


STRUCTURAL: dict[str, Callable] = {
    "broadcast_in_dim": _array(_broadcast_in_dim),
    "reshape": _array(lambda g, e, x, *s: x.reshape(e.params["new_sizes"])),
    "squeeze": _array(lambda g, e, x: np.squeeze(x, tuple(e.params["dimensions"]))),
    "expand_dims": _array(lambda g, e, x: np.expand_dims(x, e.params["dimensions"])),
    "transpose": _array(lambda g, e, x: np.transpose(x, e.params["permutation"])),
    "rev": _array(lambda g, e, x: np.flip(x, e.params["dimensions"])),
    "concatenate": _array(lambda g, e, *xs: np.concatenate(xs, e.params["dimension"])),
    "stack": _array(lambda g, e, *xs: np.stack(xs, e.params.get("axis", 0))),
    "tile": _array(lambda g, e, x: np.tile(x, e.params["reps"])),
    "slice": _array(_slice),
    "pad": _array(_pad),
    "iota": _array(_iota),
    "dynamic_slice": _array(_dynamic_slice),
    "dynamic_update_slice": _array(_dynamic_update_slice),
    "gather": _array(_by_position),
    "scatter": _array(_by_position),
    "scatter-add": _array(_scatter_add),
    "scatter_add": _array(_scatter_add),
    "reduce_sum": _array(_reduction("add")),
    "reduce_prod": _array(_reduction("mul")),
    "reduce_max": _array(_reduction("max")),
    "reduce_min": _array(_reduction("min")),
    "reduce_and": _array(_reduction("and")),
    "reduce_or": _array(_reduction("or")),
    "argmax": _array(_argument("gt")),
    "argmin": _array(_argument("lt")),
    "cumsum": _array(_cumulative("add")),
    "cumprod": _array(_cumulative("mul")),
    "cummax": _array(_cumulative("max")),
    "cummin": _array(_cumulative("min")),
    "dot_general": _array(_dot_general),
    "split": lambda g, e, x: np.split(
        x, np.cumsum(e.params["sizes"])[:-1], e.params["axis"]
    ),
    "unstack": lambda g, e, x: [
        np.take(x, [k], e.params["axis"]).squeeze(e.params["axis"])
        for k in range(x.shape[e.params["axis"]])
    ],
    "optimization_barrier": lambda g, e, *xs: list(xs),
}
