"""Functions that stay functions (outlining): what a program evaluates many times on other
numbers is machine code once, rather than once for each time."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._ir.graph import Graph
from .._ir.node import BOOL
from .._ir.several import Several

NAME = "aslo_jax_outlined_"  # and a number, of a `jax.jit`
ALWAYS = 1_000_000  # times: one that stays a function, short as it may be
GATED = "gated_"  # between both
MOVING = 2  # its last arguments, which change over time


class Outline(NamedTuple):
    """What a function makes, as nodes of its symbolic arguments, the `results` of which are
    those of a `function` of several, and what that needs besides, `fixed` over time."""

    found: list[np.ndarray]
    results: list[int]
    function: Several
    fixed: list[int]


def name_of(times: int, gated: bool = False) -> str:
    """The name of a function that is evaluated so many times; of a `gated` one the results
    are zero where the first entry of its last arguments is, see [`Several`][]."""
    return f"{NAME}{GATED if gated else ''}{times}"


def is_outlined(equation: Any) -> bool:
    return equation.params.get("name", "").startswith(NAME)


def outlined(
    graph: Graph,
    equation: Any,
    inline: Callable[[list[Any]], list[Any]],
    arguments: Sequence[np.ndarray],
) -> list[np.ndarray]:
    """The results of a function of arrays of node numbers, which `inline` puts into the
    graph: as parts of one function of scalars. What does not depend on the last arguments
    is not a part of it, but computed before."""
    moving, still = arguments[-MOVING:], arguments[:-MOVING]
    numbers = [int(n) for array in moving for n in array.flat]
    jaxpr = equation.params["jaxpr"]
    dtypes = (graph.dtype(n) for n in numbers)
    key = id(jaxpr), *(array.tobytes() for array in still), *dtypes
    if key not in graph.outlined:
        name = equation.params["name"].removeprefix(NAME)
        kind = int(name.removeprefix(GATED)), name.startswith(GATED)
        # With the jaxpr itself, so that nothing else comes to have its number.
        graph.outlined[key] = jaxpr, _outline(graph, inline, moving, still, *kind)
    _, outline = graph.outlined[key]
    if outline is None:
        return inline(list(arguments))
    parts = graph.parts(outline.function, *numbers, *outline.fixed)
    new = dict(zip(outline.results, parts, strict=True))
    return [
        np.array([new.get(int(n), int(n)) for n in array.flat], np.int64).reshape(
            array.shape
        )
        for array in outline.found
    ]


def _outline(
    graph: Graph,
    inline: Callable[[list[Any]], list[Any]],
    moving: Sequence[np.ndarray],
    still: Sequence[np.ndarray],
    times: int,
    gated: bool,
) -> Outline | None:
    """Of a function that is evaluated so many times, if that is worth it."""
    numbers = [int(n) for array in moving for n in array.flat]
    inputs = [graph.input(graph.dtype(n), ("argument", k)) for k, n in enumerate(numbers)]
    left, symbols = list(inputs), []
    for array in moving:
        symbols.append(np.array(left[: array.size], np.int64).reshape(array.shape))
        left = left[array.size :]
    found = [np.asarray(x) for x in inline([*still, *symbols])]
    outs = [int(n) for array in found for n in array.flat]
    own, needed = set(inputs), graph.reachable(outs)
    for number in needed:
        if not own.isdisjoint(graph.nodes[number].args):
            own.add(number)
    results = [n for n in dict.fromkeys(outs) if n in own]
    if len(own) * times < graph.goal.outlined or not results:
        return None
    order = [n for n in needed if n in own]
    function, fixed = _extracted(graph, order, inputs, results)
    return Outline(found, results, function._replace(gated=gated), fixed)


def _extracted(
    graph: Graph, own: list[int], inputs: list[int], results: list[int]
) -> tuple[Several, list[int]]:
    """The nodes `own` as a function, and what it needs besides its inputs."""
    inner, fixed = Graph(graph.goal), list[int]()
    new = {n: inner.input(graph.dtype(n), ("argument", k)) for k, n in enumerate(inputs)}

    def operand(number: int) -> int:
        node = graph.nodes[number]
        if number in new:
            return new[number]
        if node.op == "const":
            new[number] = inner.const(node.data, node.dtype)
        elif node.dtype == BOOL:  # handed over as a number: masks have no arrays
            one, zero = (graph.const(x, np.float64) for x in (1, 0))
            as_number = graph.select(number, one, zero)
            slot = ("argument", len(inputs) + len(fixed))
            fixed.append(as_number)
            given = inner.input(np.float64, slot)
            new[number] = inner.op("gt", given, inner.const(0.5, np.float64))
        else:
            slot = ("argument", len(inputs) + len(fixed))
            fixed.append(number)
            new[number] = inner.input(node.dtype, slot)
        return new[number]

    for number in own:
        if number not in new:
            node = graph.nodes[number]
            new[number] = inner.made(node, tuple(operand(a) for a in node.args))
    return Several(inner, tuple(new[n] for n in results), len(inputs)), fixed
