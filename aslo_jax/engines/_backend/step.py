"""A step of a loop for some lanes at a time: what its vectors are made of, in which order,
and which of them wait in memory (unroll factor, schedule and spill code)."""

import copy
import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from ..._ir.loop import Loop, varying
from ..._ir.node import BOOL, LOOPED
from ..._ir.selection import Instruction, selected
from ..._ir.specialisation import specialised
from .cost import cycles
from .grouping import entries, needed_later, phases
from .scheduling import depth_first, ordered
from .spilling import Event, planned
from .splitting import Part, in_parts
from .target import Target

# Bytes of arrays that are fixed over time, and different for each lane: half of a cache of
# the second level, as small as it is today.
CACHE = 2**18


class Body:
    """What a step of a loop does, on however many lanes.

    - `varies`: for each node, whether it does over time and over lanes;
    - `scalars`: what a step makes for all lanes; `orders` of the vectors that it makes: one
      in which long chains of operations go on beside each other, one in which little waits;
    - `groups`: those of its vectors that loops make;
    - `record`: what only the records need, and `leaving`, the vectors of a step for it;
    - `stored`: what must be in memory once it is made;
    - `instructions`: how a vector is made, but for those that are a part of another one;
    - `nodes`: operations by number, those of the graph or of what is left of it.
    """

    def __init__(self, loop: Loop) -> None:
        self.loop, graph = loop, loop.graph
        self.nodes = graph.nodes
        self.varies = varying(graph, loop.needed())
        if loop.switches:  # what a condition that is known may leave in its place
            self.varies |= {graph.const(b, BOOL): (False, False) for b in (0, 1)}
        whole = graph.reachable(list(loop.carry))
        step = self.moving(whole)
        rest = set(graph.reachable(list(loop.record))) - set(whole)
        self.record = self.moving(sorted(rest))
        self.scalars = [n for n in step if not self.varies[n][1]]
        vectors = {n for n in step if self.varies[n][1] and graph.nodes[n].op != "input"}
        needed = {a for n in self.record for a in graph.nodes[n].args} | set(loop.record)
        self.leaving = vectors & needed
        self.phases = phases(graph.nodes, sorted(vectors), self.varies)
        self.groups = [group for phase in self.phases for group in phase.groups]
        self.read = entries(graph, self.groups) & vectors
        self.orders = self._ordered(loop)
        chosen = selected(graph, self.orders[0], self.stored)
        self.instructions = {x.result: x for x in chosen}

    @property
    def stored(self) -> set[int]:
        return self.leaving | set(self.loop.carry) | self.read

    @property
    def lane_bytes(self) -> int:
        """Of what is fixed over time in the arrays of groups, for each lane."""
        arrays = {a for group in self.groups for a in group.arrays(self.loop.graph)}
        fixed = [n for a in arrays for n in a if self.varies[n] == (False, True)]
        return sum(self.loop.graph.dtype(n).itemsize for n in fixed)

    def _ordered(self, loop: Loop) -> tuple[list[int], list[int]]:
        graph, first, second = loop.graph, [], []
        for k, (groups, rest) in enumerate(self.phases):
            members = [n for group in groups for n in group.members]
            roots = needed_later(graph, self.phases, k, loop.carry)
            first += [*members, *ordered(graph, rest)]
            second += [*members, *depth_first(graph, roots, set(rest))]
        return first, second

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
    """A body for `width` lanes at a time, on a target: how it and its alternatives make
    their vectors, in the order that should be faster, or in that with the number
    `order`. The instruction `group` with the result `Part(-1, k)` is the k-th group of the
    body."""

    def __init__(
        self, body: Body, width: int, target: Target, order: int | None = None
    ) -> None:
        self.body, self.width, self.target = body, width, target
        self._counts: dict[int, int] = {}
        self._order = order
        self.usual = self._way(body.alternatives[0])

    @functools.cached_property
    def ways(self) -> list[Way]:
        """The usual one first; the others are planned for the width that is chosen."""
        return [self.usual, *map(self._way, self.body.alternatives[1:])]

    def parts(self, number: int) -> int:
        """How many registers the lanes of a node fill; those of a mask, as many as what it
        compares, or of doubles where that is not known."""
        if number not in self._counts:
            node = self.body.loop.graph.nodes[number]
            if node.dtype == np.bool_ and node.args:
                count = max(map(self.parts, node.args))
            else:
                size = 8 if node.dtype == np.bool_ else node.dtype.itemsize
                count = -(-self.width * size // self.target.register)
            self._counts[number] = count
        return self._counts[number]

    def _way(self, body: Body) -> Way:
        orders = body.orders if self._order is None else [body.orders[self._order]]
        plans = [self._planned(body, order) for order in orders]
        if len(plans) == 1:
            return Way(body, plans[0])
        price = lambda events: cycles(body.loop, events, self.target)
        return Way(body, min(plans, key=price))

    def _planned(self, body: Body, order: Sequence[int]) -> list[Event[Part]]:
        kept = {Part(n, k) for n in body.stored for k in range(self.parts(n))}
        loops = {g.members[0]: k for k, g in enumerate(body.groups)}
        instructions = [body.instructions[n] for n in order if n in body.instructions]
        made: list[Instruction[Part]] = []
        for looped, some in groupby(instructions, lambda x: x.op in LOOPED):
            if looped:
                numbers = [loops[x.result] for x in some if x.result in loops]
                made += [Instruction(Part(-1, k), "group", ()) for k in numbers]
                continue
            some = list(some)
            values = {v for x in some for v in (x.result, *x.args)}
            alike = {v for v in values if not body.varies[v][1]}
            counts = {v: self.parts(v) for v in values}
            made += in_parts(some, counts, alike, self.target.turn)
        return list(planned(made, kept, self.target.registers))

    @functools.cached_property
    def cycles(self) -> float:
        """That it usually takes, estimated, for one lane."""
        usual = self.usual
        return cycles(usual.body.loop, usual.events, self.target) / self.width

    def instructions(self) -> int:
        """About how many it usually takes."""
        return sum(e.action in ("load", "store", "do") for e in self.usual.events)


def chosen(loop: Loop, widths: Sequence[int], target: Target) -> Step:
    """A step for so many lanes at a time, and in that order, that one lane should take
    the fewest cycles. No bits depend on it."""
    body, best = Body(loop), None
    fitting = [w for w in widths if w * body.lane_bytes <= CACHE] or [min(widths)]
    for width in sorted(fitting):
        steps = (Step(body, width, target, order) for order in (0, 1))
        step = min(steps, key=lambda step: step.cycles)
        if best is not None and best.cycles <= step.cycles:
            break  # with more lanes still it is slower still
        best = step
        if step.instructions() > target.decoded:
            break  # as many again for every further register, and as long to compile
    assert best is not None, "there is a width"
    return best
