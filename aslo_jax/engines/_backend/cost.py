"""How many cycles a step takes, estimated (a cost model: a simulated pipeline): to choose
between orders of its operations, and between numbers of lanes at a time."""

import collections
import math
from collections.abc import Sequence

from ..._ir.latency import LATENCY
from ..._ir.loop import Loop
from ..._ir.rewrite import carries
from .spilling import Event
from .splitting import Part
from .target import Target

STEPS = 3  # until one is like the next
LOAD, STORE = 4, 1  # cycles
PRODUCTS = {"mul", "fma", "muladd", "mulsub", "submul"}
# Of what the first-level cache has no room for, cycles for so many bytes, out and in again.
LINE, LINE_CYCLES = 64, 2


def cycles(loop: Loop, events: Sequence[Event[Part]], target: Target) -> float:
    """Of one step among many, each of which waits for the carry of the one before."""
    total = _Pipeline(loop, target).run(events)
    count = sum(e.action in ("load", "store", "do") for e in events)
    if count > target.decoded:
        total = max(total, count / target.fetched)
    more = _memory(loop, events) * target.register - target.cache
    return total + max(more, 0) / LINE * LINE_CYCLES


def _memory(loop: Loop, events: Sequence[Event[Part]]) -> int:
    """About how many registers a step has in memory: what it reads and does not make, its
    carry, and the most that wait there at a time."""
    made = {e.value for e in events if e.instruction}
    read = {a for e in events if e.instruction for a in e.instruction.args}
    waiting = most = 0
    for event in events:
        waiting += (event.action == "store") - (event.action == "free")
        most = max(most, waiting)
    entries = set(loop.carry)
    return len(read - made) + sum(v.number in entries for v in made) + most


class _Pipeline:
    """A processor that begins some events a cycle, in their order, and none before the one
    so many back has ended; each when what it needs is there, and a port is free."""

    def __init__(self, loop: Loop, target: Target) -> None:
        self.loop, self.target = loop, target
        self.multiplying: dict[int, int] = collections.defaultdict(int)
        self.loading: dict[int, int] = collections.defaultdict(int)

    def _load(self, time: float) -> float:
        """When what is in memory is there."""
        return _free(self.loading, time, self.target.loads) + LOAD

    def run(self, events: Sequence[Event[Part]]) -> float:
        """Cycles of the last of some steps."""
        loop, target = self.loop, self.target
        read = {a for e in events if e.instruction for a in e.instruction.args}
        inputs = carries(loop.graph, {a.number for a in read})
        entry = {number: loop.carry[i] for i, number in inputs.items()}
        before = {a: Part(entry[a.number], a.place) for a in read if a.number in entry}
        began = ended = start = 0.0
        order: collections.deque[float] = collections.deque(maxlen=target.ahead)
        last: dict[Part, float] = {}
        for _ in range(STEPS):
            start, ready = ended, {}
            for event in events:
                if event.action in ("free", "drop"):
                    continue
                began += 1 / target.rate
                if len(order) == target.ahead:
                    began = max(began, order[0])
                value, instruction, done = event.value, event.instruction, began
                if event.action == "load":
                    done = max(done, ready.get(value, 0.0))
                    done = self._load(max(done, last.get(before.get(value, value), 0.0)))
                elif instruction is None:
                    done = max(done, ready.get(value, 0.0)) + STORE
                else:
                    for a in instruction.args:
                        at = ready.get(a)
                        if at is None:
                            at = max(self._load(began), last.get(before.get(a, a), 0.0))
                        done = max(done, at)
                    if instruction.op in PRODUCTS:
                        done = _free(self.multiplying, done, target.products)
                    done += LATENCY.get(instruction.op, 1)
                if event.action != "store":
                    ready[value] = done
                ended = max(ended, done)
                order.append(ended)
            last = ready
        return ended - start


def _free(port: dict[int, int], time: float, most: int) -> int:
    """The first cycle from some time on in which a port is not taken so many times: takes
    it."""
    cycle = math.ceil(time)
    while port[cycle] >= most:
        cycle += 1
    port[cycle] += 1
    return cycle
