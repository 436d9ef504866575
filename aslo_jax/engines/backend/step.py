"""A step of a loop for some lanes at a time: what its vectors are made of, in which order,
and which of them wait in memory."""

import copy
import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..ir.graph import BOOL
from ..ir.loop import Loop, varying
from ..ir.selection import selected
from ..ir.specialisation import specialised
from .cost import cycles
from .scheduling import depth_first, ordered
from .spilling import Event, planned
from .splitting import Part, in_parts

# Registers, by their bytes: of AVX2, and of AVX-512.
HOLDING = {32: 16, 64: 32}
# Of more instructions than that, a processor decodes each anew in every step. On AVX2 the
# loop with five observers takes 2,430 for eight lanes in one order and 2,040 in the other,
# which runs 1.8 times as fast.
DECODED = 2_400


class Body:
    """What a step of a loop does, on however many lanes.

    - `varies`: for each node, whether it does over time and over lanes;
    - `scalars`: what a step makes for all lanes; `orders` of the vectors that it makes: one
      in which long chains of operations go on beside each other, one in which little waits;
    - `record`: what only the records need, and `leaving`, the vectors of a step for it;
    - `instructions`: how a vector is made, but for those that are a part of another one;
    - `nodes`: operations by number, those of the graph or of what is left of it.
    """

    def __init__(self, loop: Loop):
        self.loop, graph = loop, loop.graph
        self.nodes = graph.nodes
        self.varies = varying(graph, loop.needed())
        whole = graph.reachable(list(loop.carry))
        step = self.moving(whole)
        rest = set(graph.reachable(list(loop.record))) - set(whole)
        self.record = self.moving(sorted(rest))
        self.scalars = [n for n in step if not self.varies[n][1]]
        vectors = {n for n in step if self.varies[n][1] and graph.nodes[n].op != "input"}
        needed = {a for n in self.record for a in graph.nodes[n].args} | set(loop.record)
        self.leaving = vectors & needed
        self.orders = (
            ordered(graph, sorted(vectors)),
            depth_first(graph, loop.carry, vectors),
        )
        chosen = selected(graph, self.orders[0], self.leaving | set(loop.carry))
        self.instructions = {x.result: x for x in chosen}

    @functools.cached_property
    def alternatives(self) -> list["Body"]:
        """This body, or one for where all switches are as usual, one for where none is,
        and itself for where they, or lanes, do not agree."""
        switches = self.loop.switches
        if not switches:
            return [self]
        special = [
            self._where({n: usual == same for n, usual in switches})
            for same in (True, False)
        ]
        agree = len(switches) == 1 and not self.varies[switches[0].condition][1]
        return special if agree else [*special, self]

    def _where(self, conditions: Mapping[int, bool]) -> "Body":
        """What is left where it is known which conditions hold: some of the same
        instructions, made by the step if they are here, and by the record if they are
        there. A lane gets the same bits in whichever body."""
        made, graph = copy.copy(self), self.loop.graph
        roots = [*self.loop.carry, *self.loop.record]
        left = specialised(graph, roots, conditions)
        made.loop = dataclasses.replace(
            self.loop,
            carry=tuple(left.same[n] for n in self.loop.carry),
            record=tuple(left.same[n] for n in self.loop.record),
        )
        made.nodes = left.nodes
        made.varies = self.varies | {graph.const(b, BOOL): (False, False) for b in (0, 1)}
        made.record = [n for n in self.record if n in left.nodes]
        needed = {a for n in made.record for a in left.nodes[n].args}
        vectors = left.nodes.keys() & set(self.orders[0])
        made.leaving = vectors & (needed | set(made.loop.record))
        made.orders = (
            ordered(left, sorted(vectors)),
            depth_first(left, [*made.loop.carry, *made.leaving], vectors),
        )
        made.instructions = {
            n: x._replace(args=tuple(left.same[a] for a in x.args))
            for n, x in self.instructions.items()
            if n in vectors
        }
        return made

    def moving(self, numbers: Iterable[int]) -> list[int]:
        return [n for n in numbers if self.varies[n][0]]


class Way(NamedTuple):
    """A body, and the `events` that make its vectors."""

    body: Body
    events: list[Event[Part]]

    @property
    def made(self) -> set[int]:
        return {e.value.number for e in self.events if e.instruction}


class Step:
    """A body for `width` lanes at a time, in registers of so many bytes: how it and its
    alternatives make their vectors, in the order that promises to be faster."""

    def __init__(self, body: Body, width: int, register: int):
        self.body, self.width, self.register = body, width, register
        self._counts: dict[int, int] = {}
        self.usual = Way(body.alternatives[0], self._planned(body.alternatives[0]))

    @functools.cached_property
    def ways(self) -> list[Way]:
        """The usual one first; the others are planned for the width that is chosen."""
        others = self.body.alternatives[1:]
        return [self.usual, *(Way(b, self._planned(b)) for b in others)]

    def parts(self, number: int) -> int:
        """How many registers the lanes of a node fill; those of a mask, as many as what it
        compares, or of doubles where that is not known."""
        if number not in self._counts:
            node = self.body.loop.graph.nodes[number]
            if node.dtype == np.bool_ and node.args:
                count = max(map(self.parts, node.args))
            else:
                size = 8 if node.dtype == np.bool_ else node.dtype.itemsize
                count = -(-self.width * size // self.register)
            self._counts[number] = count
        return self._counts[number]

    def _planned(self, body: Body) -> list[Event[Part]]:
        loop = body.loop
        stored = body.leaving | set(loop.carry)
        kept = {Part(n, k) for n in stored for k in range(self.parts(n))}

        def plan(order: list[int]) -> list[Event[Part]]:
            instructions = [body.instructions[n] for n in order if n in body.instructions]
            values = {v for x in instructions for v in (x.result, *x.args)}
            alike = {v for v in values if not body.varies[v][1]}
            made = in_parts(instructions, {v: self.parts(v) for v in values}, alike)
            return list(planned(made, kept, HOLDING[self.register]))

        plans = map(plan, body.orders)
        return min(plans, key=lambda events: cycles(loop, events))

    def instructions(self) -> int:
        """About how many it usually takes."""
        return sum(e.action in ("load", "store", "do") for e in self.usual.events)


def chosen(loop: Loop, widths: Sequence[int], register: int) -> Step:
    """A step for the most lanes at a time of which the processor keeps the instructions, or
    else for those that need the fewest. No bits depend on it."""
    body = Body(loop)
    steps = [Step(body, width, register) for width in sorted(widths, reverse=True)]
    return min(steps, key=lambda step: max(step.instructions(), DECODED))
