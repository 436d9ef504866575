"""Functions that stay functions (outlining): what a program evaluates many times on other
numbers is machine code once, rather than once for each time."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._ir.graph import BOOL, Graph
from .._ir.several import Several

NAME = "aslo_jax_outlined_"  # and a number, of a `jax.jit`
MOVING = 2  # its last arguments, which change over time
# Operations of all evaluations of a function from which on it is outlined: what a processor
# keeps decoded (`Target`), less what is between them.
LEAST = 2000


def name_of(times: int) -> str:
    """The name of a function that is evaluated so many times."""
    return f"{NAME}{times}"


def is_outlined(equation: Any) -> bool:
    return equation.params.get("name", "").startswith(NAME)


class Outline(NamedTuple):
    """A function of arrays as one of scalars: its results, nodes of the graph by their
    arrays; those of the `function`, None where it is not worth one, and what is `fixed` of
    its arguments; the `jaxpr`, which lives as long."""

    found: list[np.ndarray]
    results: list[int]
    function: Several | None
    fixed: list[int]
    jaxpr: Any


def outlined(
    graph: Graph,
    equation: Any,
    inline: Callable[[list[Any]], list[Any]],
    arguments: Sequence[np.ndarray],
) -> list[np.ndarray]:
    """The results of a function of arrays of node numbers, which `inline` puts into the
    graph: as parts of one function of scalars. What does not depend on the last arguments
    is not a part of it, but computed before."""
    given = arguments[-MOVING:]
    numbers = [int(n) for array in given for n in array.flat]
    jaxpr = equation.params["jaxpr"]
    before = (array.tobytes() for array in arguments[:-MOVING])
    key = id(jaxpr), *before, *(graph.dtype(n) for n in numbers)
    if key not in graph.outlined:
        times = int(equation.params["name"].removeprefix(NAME))
        graph.outlined[key] = _outline(graph, jaxpr, times, inline, arguments)
    outline = graph.outlined[key]
    if outline.function is None:
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
    graph: Graph, jaxpr: Any, times: int, inline: Callable, arguments: Sequence[np.ndarray]
) -> Outline:
    """Without a function where this is not worth one."""
    given, inputs, symbols = arguments[-MOVING:], list[int](), []
    for array in given:
        slots = range(len(inputs), len(inputs) + array.size)
        dtypes = (graph.dtype(int(n)) for n in array.flat)
        own = [
            graph.input(dtype, ("argument", k))
            for k, dtype in zip(slots, dtypes, strict=True)
        ]
        symbols.append(np.array(own, np.int64).reshape(array.shape))
        inputs += own
    found = [np.asarray(x) for x in inline([*arguments[:-MOVING], *symbols])]
    outs = [int(n) for array in found for n in array.flat]
    own, moving = set(inputs), graph.reachable(outs)
    for number in moving:
        if not own.isdisjoint(graph.nodes[number].args):
            own.add(number)
    results = [n for n in dict.fromkeys(outs) if n in own]
    if len(own) * times < LEAST or not results:
        return Outline(found, [], None, [], jaxpr)
    function, fixed = _extracted(graph, [n for n in moving if n in own], inputs, results)
    return Outline(found, results, function, fixed, jaxpr)


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
