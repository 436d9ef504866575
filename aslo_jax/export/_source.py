"""The text of the `.c` file: a start and a step."""

from collections.abc import Sequence
from typing import NamedTuple

from .._ir.graph import Graph
from .._ir.loop import varying
from ..engines._c.body import Body, Target
from ..engines._c.places import Place, Value
from ..engines._c.unit import Unit
from ._fields import Field
from ._functions import functions
from ._traced import Traced


class Source(NamedTuple):
    """The text, the operations of a step, how many of these follow from the parameters
    alone, and the bytes of automatic variables of a step."""

    text: str
    operations: int
    of_parameters: int
    automatic: int


class Places:
    """Where the entries of fields are, one after the other."""

    def __init__(self, fields: Sequence[Field], before: str) -> None:
        self.entries: list[Value] = []
        for field in fields:
            name = f"{before}{field.name}"
            if field.is_array:
                self.entries += [Place(name, k) for k in range(field.size)]
            else:
                self.entries.append(name)


def targets(fields: Sequence[Field], numbers: Sequence[int], before: str) -> list[Target]:
    """Where to put the nodes of fields."""
    found, at = [], 0
    for field in fields:
        some = tuple(numbers[at : at + field.size])
        at += field.size
        if some:
            found.append(Target(f"{before}{field.name}", some, field.is_array))
    return found


def source(traced: Traced, prefix: str, refuses: bool, head: str) -> Source:
    """The file after its `head`; `refuses`: whether a step refuses what is not finite."""
    loop, unit = traced.loop, Unit(prefix)
    graph = loop.graph
    given = {
        "shared": Places(traced.parameters, "parameters->").entries,
        "carry": Places(traced.state, "state->").entries,
    }
    where = lambda kinds: lambda slot: (given | kinds)[slot[0]][slot[1]]
    begin = Body(
        unit,
        graph,
        [*loop.first, *loop.begin],
        where({"lane": Places(traced.first, "").entries}),
    )
    start = [*targets(traced.outputs, loop.first, "output->")]
    for target in (*start, *targets(traced.state, loop.begin, "state->")):
        begin.put(target)
    step = Body(
        unit,
        graph,
        [*loop.record, *loop.carry],
        where({"log": Places(traced.inputs, "").entries}),
        loop.carry,
    )
    for target in targets(traced.outputs, loop.record, "output->"):
        step.put(target)
    _advance(step, graph, traced, loop.carry)
    made = functions(traced, prefix, refuses, unit, begin.lines, step.lines)
    text = "\n\n".join([head, *unit.parts, *made])
    return Source(text + "\n", *_counted(traced), max(step.automatic, begin.automatic))


def _advance(step: Body, graph: Graph, traced: Traced, carry: Sequence[int]) -> None:
    """Writes the next state, what moves within it only after it has been read."""
    moved = {}
    for i, number in enumerate(carry):
        node = graph.nodes[number]
        if node.op == "input" and node.data[0] == "carry" and node.data[1] != i:
            moved.setdefault(node.dtype, []).append(number)
    for numbers in moved.values():
        step.copied(list(dict.fromkeys(numbers)))
    for target in targets(traced.state, carry, "state->"):
        still = all(
            graph.nodes[n].op == "input" and step.text(n) == where
            for n, where in zip(target.numbers, _names(target), strict=True)
        )
        if not still:
            step.put(target)


def _names(target: Target) -> list[str]:
    if not target.is_array:
        return [target.name]
    return [Place(target.name, k).text for k in range(len(target.numbers))]


def _counted(traced: Traced) -> tuple[int, int]:
    graph = traced.loop.graph
    varies = varying(graph, traced.loop.of_a_step())
    sizes = [(graph.nodes[n].size, time) for n, (time, _) in varies.items()]
    return sum(n for n, _ in sizes), sum(n for n, time in sizes if not time)
