"""A step of a loop for some lanes at a time: what its vectors are made of, in which order,
and which of them wait in memory (unroll factor, schedule and spill code)."""

import functools
from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np

from ..ir.loop import Loop, varying
from ..ir.selection import Instruction, selected
from .cost import cycles
from .grouping import LOOPED, entries, needed_later, phases
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
    - `stored`: what must be in memory once it is made.
    """

    def __init__(self, loop: Loop):
        self.loop, graph = loop, loop.graph
        self.varies = varying(graph, loop.needed())
        whole = graph.reachable(list(loop.carry))
        step = self.moving(whole)
        rest = set(graph.reachable(list(loop.record))) - set(whole)
        self.record = self.moving(sorted(rest))
        self.scalars = [n for n in step if not self.varies[n][1]]
        vectors = {n for n in step if self.varies[n][1] and graph.nodes[n].op != "input"}
        needed = {a for n in self.record for a in graph.nodes[n].args} | set(loop.record)
        self.leaving = vectors & needed
        self.phases = phases(graph, sorted(vectors), self.varies)
        self.groups = [group for phase in self.phases for group in phase.groups]
        read = entries(graph, self.groups) & vectors
        self.stored = self.leaving | set(loop.carry) | read
        self.orders = self._ordered(loop)

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

    def moving(self, numbers: Iterable[int]) -> list[int]:
        return [n for n in numbers if self.varies[n][0]]


class Step:
    """A body for `width` lanes at a time, on a target: `events` are how it makes its
    vectors, in the order that promises to be faster. The instruction `group` with the
    result `Part(-1, k)` is the k-th group of the body."""

    def __init__(
        self, body: Body, width: int, target: Target, order: Sequence[int] | None = None
    ):
        self.body, self.width, self.target = body, width, target
        self._counts: dict[int, int] = {}
        self.events = self._planned(body.orders[0] if order is None else order)

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

    def _planned(self, order: Sequence[int]) -> list[Event[Part]]:
        loop, stored = self.body.loop, self.body.stored
        kept = {Part(n, k) for n in stored for k in range(self.parts(n))}
        loops = {g.members[0]: k for k, g in enumerate(self.body.groups)}
        instructions, made = selected(loop.graph, order, stored), []
        for looped, some in groupby(instructions, lambda x: x.op in LOOPED):
            if looped:
                some = [loops[x.result] for x in some if x.result in loops]
                made += [Instruction(Part(-1, k), "group", ()) for k in some]
                continue
            some = list(some)
            values = {v for x in some for v in (x.result, *x.args)}
            alike = {v for v in values if not self.body.varies[v][1]}
            counts = {v: self.parts(v) for v in values}
            made += in_parts(some, counts, alike, self.target.turn)
        return list(planned(made, kept, self.target.registers))

    @functools.cached_property
    def cycles(self) -> float:
        """That it takes, estimated, for one lane."""
        return cycles(self.body.loop, self.events, self.target) / self.width

    def instructions(self) -> int:
        """About how many it takes."""
        return sum(e.action in ("load", "store", "do") for e in self.events)


def chosen(loop: Loop, widths: Sequence[int], target: Target) -> Step:
    """A step for so many lanes at a time, and in that order, that one lane promises to take
    the fewest cycles. No bits depend on it."""
    body, best = Body(loop), None
    fitting = [w for w in widths if w * body.lane_bytes <= CACHE] or [min(widths)]
    for width in sorted(fitting):
        steps = (Step(body, width, target, order) for order in body.orders)
        step = min(steps, key=lambda step: step.cycles)
        if best is not None and best.cycles <= step.cycles:
            break  # with more lanes still it is slower still
        best = step
    assert best is not None, "there is a width"
    return best
