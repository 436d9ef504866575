"""Reading and writing at indices, which may be known when a function is traced or vary.

An index that varies costs a select for each place that it can have; of a table of
constants with many entries it is a load. Out of bounds means what it does to XLA: reads
are held within the array or filled, slices are held within it, updates are dropped.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from .._ir.graph import Graph
from .elementwise import ELEMENTWISE, Unsupported
from .values import Value, array, known, select

SELECTED = 64  # the most places of an array of constants that are read by selects
SELECTS = 4096  # the most selects of one read or update
MODE = jax.lax.GatherScatterMode
Combine = Callable[[Graph, int, int], int]


def window(graph: Graph, x: Value, starts: Sequence[int], sizes: Sequence[int]) -> Value:
    """The part of `x` of the given sizes from `starts`, each held within its axis."""
    traced = []
    for axis, (start, size) in enumerate(zip(starts, sizes, strict=True)):
        last, value = x.shape[axis] - size, graph.value(start)
        if last and value is None:
            traced.append(axis)
        else:
            at = min(max(int(value or 0), 0), last)
            x = _cut(x, axis, at, size)
    places = int(np.prod([x.shape[a] - sizes[a] + 1 for a in traced], dtype=int))
    if places > SELECTED:
        table = known(graph, x)
        if table is not None:
            return _read(graph, table, traced, starts, sizes)
    _bearable(places * int(np.prod(sizes, dtype=int)))
    for axis in traced:
        x = _picked(graph, x, axis, starts[axis], sizes[axis])
    return x


def _bearable(selects: int) -> None:
    if selects > SELECTS:
        raise Unsupported(
            f"its index varies, which takes {selects} selects, more than {SELECTS}, of an "
            "array that is not constant"
        )


def _cut(x: Value, axis: int, at: int, size: int) -> Value:
    return x[(*(slice(None),) * axis, slice(at, at + size))]


def _picked(graph: Graph, x: Value, axis: int, start: int, size: int) -> Value:
    """A part along one axis: a tree of selects, the first and the last piece for indices
    beyond the ends."""
    last = x.shape[axis] - size
    start = _wide(graph, start, last)

    def among(low: int, high: int) -> Value:
        if low == high:
            return _cut(x, axis, low, size)
        middle = (low + high) // 2
        here = graph.op("le", start, graph.const(middle, graph.dtype(start)))
        return select(graph, here, among(low, middle), among(middle + 1, high))

    return among(0, last)


def _wide(graph: Graph, index: int, last: int) -> int:
    """An index of a type that holds `last`."""
    small = np.iinfo(graph.dtype(index)).max < last
    return graph.convert(index, np.int64) if small else index


def _held(graph: Graph, index: int, last: int) -> int:
    """An index within 0 and `last`."""
    index = _wide(graph, index, last)
    for op, bound in (("lt", 0), ("gt", last)):
        limit = graph.const(bound, graph.dtype(index))
        index = graph.select(graph.op(op, index, limit), limit, index)
    return index


def _read(
    graph: Graph,
    table: np.ndarray,
    traced: Sequence[int],
    starts: Sequence[int],
    sizes: Sequence[int],
) -> Value:
    """A part of constants at an index that varies: a log, a reference."""
    number = graph.const(0, np.int64)
    strides = np.cumprod([1, *table.shape[:0:-1]])[::-1]
    for axis in traced:
        start = _held(graph, starts[axis], table.shape[axis] - sizes[axis])
        start = graph.convert(start, np.int64)
        step = graph.const(int(strides[axis]), np.int64)
        number = graph.op("add", number, graph.op("mul", start, step))
    out = np.empty(sizes, np.int64)
    for index in np.ndindex(out.shape):
        further = graph.const(int(np.dot(index, strides)), np.int64)
        place = graph.op("add", number, further)
        out[index] = graph.table(table.reshape(-1), place)
    return out


def _dynamic_slice(graph, equation, x, *indices):
    starts = [int(index) for index in indices]
    return window(graph, x, starts, equation.params["slice_sizes"])


def _dynamic_update_slice(graph, equation, x, update, *indices):
    lasts = np.subtract(x.shape, update.shape).tolist()
    starts = [_held(graph, int(i), last) for i, last in zip(indices, lasts, strict=True)]
    return _placed(graph, x.copy(), update, starts, _replaced)


def _starts(
    graph: Graph, rank: int, places: Sequence[int], indices: Value, batch: Any
) -> list[int]:
    """Where a part begins along each axis of an operand: `places` are the axes that the
    indices are for, `batch` pairs of an axis and its place in a batch."""
    starts = [graph.const(0, np.int64)] * rank
    for axis, index in zip(places, indices.tolist(), strict=True):
        starts[axis] = index
    for axis, at in batch:
        starts[axis] = graph.const(at, np.int64)
    return starts


def _in_batch(axes: Any, of_indices: Any, at: Sequence[int]) -> list[tuple[int, int]]:
    return [(axis, at[k]) for axis, k in zip(axes, of_indices, strict=True)]


def _within(graph: Graph, index: int, last: int) -> int:
    """Whether an index is from 0 to `last`."""
    index = _wide(graph, index, last)
    dtype = graph.dtype(index)
    above = graph.op("ge", index, graph.const(0, dtype))
    return graph.op("and", above, graph.op("le", index, graph.const(last, dtype)))


def _gather(graph, equation, x, indices):
    p = equation.params
    d, sizes, out_aval = p["dimension_numbers"], p["slice_sizes"], equation.outvars[0].aval
    fills = _mode(p) == MODE.FILL_OR_DROP
    dropped = (*d.collapsed_slice_dims, *d.operand_batching_dims)
    kept = [size for axis, size in enumerate(sizes) if axis not in dropped]
    out = np.empty((*indices.shape[:-1], *kept), np.int64)
    for at in np.ndindex(indices.shape[:-1]):
        batch = _in_batch(d.operand_batching_dims, d.start_indices_batching_dims, at)
        starts = _starts(graph, x.ndim, d.start_index_map, indices[at], batch)
        piece = window(graph, x, starts, sizes).reshape(kept)
        if fills:
            filling = np.full(
                kept, graph.const(_filling(p, out_aval.dtype), out_aval.dtype)
            )
            for axis in d.start_index_map:
                inside = _within(graph, starts[axis], x.shape[axis] - sizes[axis])
                piece = select(graph, inside, piece, filling)
        out[at] = piece
    rank = out.ndim
    return np.moveaxis(out, range(rank - len(kept), rank), d.offset_dims)


def _mode(params: dict[str, Any]) -> Any:
    mode = MODE.from_any(params["mode"])
    if mode not in (MODE.CLIP, MODE.FILL_OR_DROP, MODE.PROMISE_IN_BOUNDS):
        raise Unsupported(f"it has no rule for mode={mode}")
    return mode


def _filling(params: dict[str, Any], dtype: np.dtype) -> Any:
    if params["fill_value"] is not None:
        return params["fill_value"]
    if dtype.kind in "iu":
        return np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max
    return True if dtype.kind == "b" else np.nan


def scatter(
    graph: Graph, equation: Any, x: Value, indices: Value, updates: Value, combine: Combine
) -> Value:
    """Updates one after the other, since they may coincide."""
    p = equation.params
    d = p["dimension_numbers"]
    absent = (*d.inserted_window_dims, *d.operand_batching_dims)
    kept = [axis for axis in range(x.ndim) if axis not in absent]
    sizes = [1] * x.ndim
    for axis, k in zip(kept, d.update_window_dims, strict=True):
        sizes[axis] = updates.shape[k]
    rank = updates.ndim
    pieces = np.moveaxis(updates, d.update_window_dims, range(rank - len(kept), rank))
    out, clips = x.copy(), _mode(p) == MODE.CLIP
    for at in np.ndindex(indices.shape[:-1]):
        batch = _in_batch(d.operand_batching_dims, d.scatter_indices_batching_dims, at)
        places = d.scatter_dims_to_operand_dims
        starts = _starts(graph, x.ndim, places, indices[at], batch)
        if clips:
            for axis in places:
                starts[axis] = _held(graph, starts[axis], x.shape[axis] - sizes[axis])
        out = _placed(graph, out, pieces[at].reshape(sizes), starts, combine)
    return out


def _placed(
    graph: Graph, out: Value, piece: Value, starts: Sequence[int], combine: Combine
) -> Value:
    """`out` combined with a piece from `starts`, or as it is where the piece would not lie
    within it."""
    ranges = []
    for start, count, size in zip(starts, out.shape, piece.shape, strict=True):
        at, inside = graph.value(start), range(count - size + 1)
        ranges.append(inside if at is None else [int(at)] if int(at) in inside else [])
    places = list(itertools.product(*ranges))
    _bearable(len(places) * piece.size)
    for place in places:
        here = graph.const(True, bool)
        for start, at in zip(starts, place, strict=True):
            if graph.value(start) is None:
                bound = graph.const(at, graph.dtype(start))
                here = graph.op("and", here, graph.op("eq", start, bound))
        for index in np.ndindex(piece.shape):
            position = tuple(np.add(place, index))
            old = int(out[position])
            new = combine(graph, old, int(piece[index]))
            out[position] = graph.select(here, new, old)
    return out


def _replaced(graph: Graph, old: int, new: int) -> int:
    return new


def _scatter(combine: Combine) -> Callable:
    def rule(graph, equation, x, indices, updates):
        return scatter(graph, equation, x, indices, updates, combine)

    return array(rule)


def _combined(name: str) -> Combine:
    rule = ELEMENTWISE[name]
    return lambda graph, old, new: rule(graph, graph.dtype(old), {}, old, new)


INDEXING: dict[str, Callable] = {
    "dynamic_slice": array(_dynamic_slice),
    "dynamic_update_slice": array(_dynamic_update_slice),
    "gather": array(_gather),
    "scatter": _scatter(_replaced),
}
for _name in ("add", "sub", "mul", "min", "max"):
    INDEXING[f"scatter-{_name}"] = _scatter(_combined(_name))
    INDEXING[f"scatter_{_name}"] = INDEXING[f"scatter-{_name}"]
