"""Primitives that apply a function of scalars, or one of several solvers, which is inlined:
a rule gets `inline(closed, inputs)`, the outputs of a closed jaxpr at its inputs."""

from collections.abc import Callable
from typing import Any

import jax.extend.core as jex
import numpy as np

from .._ir.graph import Graph
from .elementwise import Unsupported
from .indexing import scatter
from .reductions import windows
from .values import Value

Inline = Callable[[Any, list[Value]], list[Value]]


def _scatter(inline: Inline, graph: Graph, equation, x, indices, updates):
    """With a function of the old value and the update: `x.at[i].apply`."""
    p = equation.params
    function = jex.ClosedJaxpr(p["update_jaxpr"], p["update_consts"])

    def combine(graph: Graph, old: int, new: int) -> int:
        (out,) = inline(function, [np.asarray(old), np.asarray(new)])
        return int(out)

    return [scatter(graph, equation, x, indices, updates, combine)]


def _reduce(inline: Inline, graph: Graph, equation, *arguments):
    """One entry after the other, from the initial values."""
    p, count = equation.params, len(equation.outvars)
    function = p["jaxpr"]
    if not hasattr(function, "consts"):
        function = jex.ClosedJaxpr(function, p["consts"])
    operands, starts = arguments[:count], arguments[count:]
    axes, rank = p["dimensions"], operands[0].ndim
    kept = [a for a in range(rank) if a not in axes]
    shape = equation.outvars[0].aval.shape
    rows = [np.transpose(x, (*kept, *axes)).reshape(*shape, -1) for x in operands]
    out = [np.empty(shape, np.int64) for _ in operands]
    for at in np.ndindex(shape):
        found = list(starts)
        for k in range(rows[0].shape[-1]):
            found = inline(function, [*found, *(np.asarray(r[at][k]) for r in rows)])
        for x, number in zip(out, found, strict=True):
            x[at] = int(number)
    return out


def _reduce_window(inline: Inline, graph: Graph, equation, x, start):
    p = equation.params
    function = jex.ClosedJaxpr(p["jaxpr"], p["consts"])
    out = np.empty(equation.outvars[0].aval.shape, np.int64)
    for at, entries in windows(equation, x, int(start)):
        found = np.asarray(start)
        for number in entries:
            (found,) = inline(function, [found, np.asarray(number)])
        out[at] = int(found)
    return [out]


def _linear_solve(inline: Inline, graph: Graph, equation, *arguments):
    """By the solver that it was given."""
    p = equation.params
    lengths, left = p["const_lengths"], list(arguments)
    count = lengths.matvec + lengths.vecmat
    consts, right = left[count : count + lengths.solve], left[sum(lengths) :]
    return inline(p["jaxprs"].solve, [*consts, *right])


def _platform_index(inline: Inline, graph: Graph, equation):
    """Which of several branches is for a processor."""
    dtype = equation.outvars[0].aval.dtype
    for k, names in enumerate(equation.params["platforms"]):
        if names is None or "cpu" in names:
            return [np.asarray(graph.const(k, dtype))]
    raise Unsupported("it has nothing for a processor")


FUNCTIONS: dict[str, Callable] = {
    "scatter": _scatter,
    "reduce": _reduce,
    "reduce_window": _reduce_window,
    "custom_linear_solve": _linear_solve,
    "platform_index": _platform_index,
}


def applies_function(equation: Any) -> bool:
    """Whether an equation has a rule here; a scatter that replaces has a simpler one."""
    name = equation.primitive.name
    if name == "scatter":
        jaxpr = equation.params.get("update_jaxpr")
        return jaxpr is not None and bool(jaxpr.eqns)
    return name in FUNCTIONS
