"""A step of a loop for some lanes at a time: what its vectors are made of, in which order,
and which of them wait in memory."""

from collections.abc import Iterable, Sequence

import numpy as np

from .loop import Loop
from .order import depth_first, ordered
from .pace import cycles
from .registers import Event, planned, selected

# Registers that hold values, by their bytes: those of AVX2 and AVX-512 without two,
# or four, for what an operation reads from memory.
HOLDING = {32: 14, 64: 28}
# Of more instructions than that, a processor decodes each anew in every step. With two
# vectors to a value on AVX2, the gradient of the PMSM's loop in two gains has 2,600, and
# runs 1.5 times as fast with one; the loop with five observers has 2,200, and runs 1.1
# times as fast with two.
DECODED = 2_400


class Body:
    """What a step of a loop does, on however many lanes.

    - `varies`: for each node, whether it does over time and over lanes;
    - `scalars`: what a step makes for all lanes; `orders` of the vectors that it makes: one
      in which long chains of operations go on beside each other, one in which little waits;
    - `record`: what only the records need, and `leaving`, the vectors of a step for it.
    """

    def __init__(self, loop: Loop):
        self.loop, graph = loop, loop.graph
        self.varies: dict[int, tuple[bool, bool]] = {}
        for number in loop.needed():
            node = graph.nodes[number]
            self.varies[number] = node.varies([self.varies[a] for a in node.args])
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

    def moving(self, numbers: Iterable[int]) -> list[int]:
        return [n for n in numbers if self.varies[n][0]]


class Step:
    """A body for `width` lanes at a time, in registers of so many bytes: `events` are how
    it makes its vectors, in the order that promises to be faster."""

    def __init__(self, body: Body, width: int, register: int):
        self.body, self.width, self.register = body, width, register
        self.events = self._planned()

    def registers(self, dtype: np.dtype) -> int:
        """Of a vector of all lanes; a mask is as wide as doubles."""
        size = 8 if dtype == np.bool_ else dtype.itemsize
        return -(-self.width * size // self.register)

    def _planned(self) -> list[Event]:
        loop = self.body.loop
        stored = self.body.leaving | set(loop.carry)

        def plan(order: list[int]) -> list[Event]:
            instructions = selected(loop.graph, order, stored)
            made = (x.number for x in instructions)
            sizes = {n: self.registers(loop.graph.dtype(n)) for n in made}
            return list(planned(instructions, sizes, stored, HOLDING[self.register]))

        plans = map(plan, self.body.orders)
        return min(plans, key=lambda events: cycles(loop.graph, events, loop.carry))

    def instructions(self) -> int:
        """About how many it takes."""
        dtype = self.body.loop.graph.dtype
        return sum(self.registers(dtype(e.number)) for e in self.events)


def chosen(loop: Loop, widths: Sequence[int], register: int) -> Step:
    """A step for the most lanes at a time of which the processor keeps the instructions, or
    else for those that need the fewest. No bits depend on it."""
    body = Body(loop)
    steps = [Step(body, width, register) for width in sorted(widths, reverse=True)]
    return min(steps, key=lambda step: max(step.instructions(), DECODED))
