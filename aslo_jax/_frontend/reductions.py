"""Reductions, running ones, and those of windows that move over an array."""

import itertools
from collections.abc import Callable

import numpy as np

from .._ir.graph import Graph
from .elementwise import ELEMENTWISE, Unsupported
from .values import Value, array, exceeds, fold, neutral

PRODUCTS = 20_000  # the most products of one convolution


def _reduction(name: str) -> Callable:
    def rule(graph, equation, x):
        axes = equation.params["axes"]
        out_aval = equation.outvars[0].aval
        kept = [a for a in range(x.ndim) if a not in axes]
        count = int(np.prod([x.shape[a] for a in axes], dtype=int))
        rows = np.transpose(x, (*kept, *axes)).reshape(*out_aval.shape, count)
        out = np.empty(out_aval.shape, np.int64)
        for index in np.ndindex(out.shape):
            out[index] = fold(graph, name, out_aval.dtype, rows[index])
        return out

    return array(rule)


def _cumulative(combine: Callable[[Graph, int, int], int]) -> Callable:
    def rule(graph, equation, x):
        axis, reverse = equation.params["axis"], equation.params["reverse"]
        out = np.moveaxis(x.copy(), axis, 0)
        out = out[::-1] if reverse else out
        for k in range(1, len(out)):
            for at in np.ndindex(out.shape[1:]):
                pair = int(out[(k - 1, *at)]), int(out[(k, *at)])
                out[(k, *at)] = combine(graph, *pair)
        return np.moveaxis(out[::-1] if reverse else out, 0, axis)

    return array(rule)


def _combined(name: str) -> Callable[[Graph, int, int], int]:
    rule = ELEMENTWISE[name]
    return lambda graph, x, y: rule(graph, graph.dtype(x), {}, x, y)


def _log_of_sum(graph: Graph, x: int, y: int) -> int:
    """`log(exp x + exp y)`, the larger one taken out; of infinities too."""
    dtype = graph.dtype(x)
    most = ELEMENTWISE["max"](graph, dtype, {}, x, y)
    far = graph.op("neg", graph.op("abs", graph.op("sub", x, y)))
    small = ELEMENTWISE["exp"](graph, dtype, {}, far)
    total = graph.op("add", most, ELEMENTWISE["log1p"](graph, dtype, {}, small))
    # Of equal infinities the difference is no number, while the larger one is right.
    return graph.select(graph.op("eq", x, y), _twice(graph, x), total)


def _twice(graph: Graph, x: int) -> int:
    """`log(2 exp x)`."""
    dtype = graph.dtype(x)
    return graph.op("add", x, graph.const(np.log(2.0), dtype))


def _argument(least: bool) -> Callable:
    """The place of the first of the largest, or smallest; no number is further out."""

    def rule(graph, equation, x):
        (axis,) = equation.params["axes"]
        dtype = equation.outvars[0].aval.dtype
        rows = np.moveaxis(x, axis, 0)
        out = np.empty(rows.shape[1:], np.int64)
        for at in np.ndindex(out.shape):
            best, place = int(rows[(0, *at)]), graph.const(0, dtype)
            for k in range(1, len(rows)):
                other = int(rows[(k, *at)])
                better = _further(graph, other, best, least)
                best = graph.select(better, other, best)
                place = graph.select(better, graph.const(k, dtype), place)
            out[at] = place
        return out

    return array(rule)


def _further(graph: Graph, x: int, y: int, least: bool) -> int:
    if not least:
        return exceeds(graph, x, y)
    if graph.dtype(x).kind != "f":
        return graph.op("lt", x, y)
    return graph.op("and", graph.op("not", graph.op("ge", x, y)), graph.op("eq", y, y))


def spaced(x: Value, filling: int, padding: list[tuple[int, int, int]]) -> Value:
    """`x` with `filling` in front of, behind and between its entries along each axis; less
    than none in front or behind cuts off."""
    for axis, (low, high, interior) in enumerate(padding):
        x = np.moveaxis(x, axis, 0)
        count = len(x)
        if interior and count:
            wide = np.full((count + (count - 1) * interior, *x.shape[1:]), filling)
            wide[:: interior + 1] = x
            x = wide
        ends = [np.full((max(n, 0), *x.shape[1:]), filling) for n in (low, high)]
        x = np.concatenate([ends[0], x, ends[1]])
        x = x[max(-low, 0) : len(x) - max(-high, 0)]
        x = np.moveaxis(x, 0, axis)
    return x


def windows(equation, x: Value, filling: int):
    """The entries of every window over `x`, by its place in the result."""
    p = equation.params
    sizes, strides = p["window_dimensions"], p["window_strides"]
    base = p.get("base_dilation") or (1,) * x.ndim
    steps = p.get("window_dilation") or (1,) * x.ndim
    padding = [(a, b, d - 1) for (a, b), d in zip(p["padding"], base, strict=True)]
    x = spaced(x, filling, padding)
    for at in np.ndindex(equation.outvars[0].aval.shape):
        ranges = [
            [start * stride + k * step for k in range(size)]
            for start, stride, size, step in zip(at, strides, sizes, steps, strict=True)
        ]
        yield at, np.array([x[place] for place in itertools.product(*ranges)])


def _windowed(name: str) -> Callable:
    def rule(graph, equation, x):
        aval = equation.outvars[0].aval
        filling = graph.const(neutral(name, aval.dtype), aval.dtype)
        out = np.empty(aval.shape, np.int64)
        for at, entries in windows(equation, x, filling):
            inside = entries[entries != filling]
            out[at] = fold(graph, name, aval.dtype, inside)
        return out

    return array(rule)


def _convolution(graph, equation, x, kernel):
    """Of few entries: a sum of products for each place."""
    p = equation.params
    if p["feature_group_count"] != 1 or p["batch_group_count"] != 1:
        raise Unsupported("it has no rule for groups")
    d, aval = p["dimension_numbers"], equation.outvars[0].aval
    zero = graph.const(0, graph.dtype(int(x.flat[0])))
    x, kernel = np.transpose(x, d.lhs_spec), np.transpose(kernel, d.rhs_spec)
    dilation = zip(p["padding"], p["lhs_dilation"], strict=True)
    x = spaced(x, zero, [(0, 0, 0)] * 2 + [(a, b, n - 1) for (a, b), n in dilation])
    out = np.empty([aval.shape[k] for k in d.out_spec], np.int64)
    if out.size * kernel[0].size > PRODUCTS:
        raise Unsupported(f"it takes more than {PRODUCTS} products")
    taps = list(np.ndindex(kernel.shape[2:]))
    for row, channel, *at in np.ndindex(out.shape):
        start = np.multiply(at, p["window_strides"])
        terms = []
        for feature, tap in itertools.product(range(kernel.shape[1]), taps):
            place = tuple(start + np.multiply(tap, p["rhs_dilation"]))
            number = int(x[(row, feature, *place)])
            if number != zero:
                weight = int(kernel[(channel, feature, *tap)])
                terms.append(graph.op("mul", number, weight))
        out[(row, channel, *at)] = fold(graph, "add", aval.dtype, np.array(terms))
    return np.transpose(out, np.argsort(d.out_spec))


REDUCTIONS: dict[str, Callable] = {
    "reduce_sum": _reduction("add"),
    "reduce_prod": _reduction("mul"),
    "reduce_max": _reduction("max"),
    "reduce_min": _reduction("min"),
    "reduce_and": _reduction("and"),
    "reduce_or": _reduction("or"),
    "reduce_xor": _reduction("xor"),
    "argmax": _argument(least=False),
    "argmin": _argument(least=True),
    "cumsum": _cumulative(_combined("add")),
    "cumprod": _cumulative(_combined("mul")),
    "cummax": _cumulative(_combined("max")),
    "cummin": _cumulative(_combined("min")),
    "cumlogsumexp": _cumulative(_log_of_sum),
    "reduce_window_sum": _windowed("add"),
    "reduce_window_max": _windowed("max"),
    "reduce_window_min": _windowed("min"),
    "conv_general_dilated": array(_convolution),
}
