"""How many cycles a step takes, estimated: to choose between orders of its operations."""

import collections
from collections.abc import Sequence

from ..ir.latency import LATENCY
from ..ir.loop import Loop
from ..ir.rewrite import carries
from .spilling import Event
from .splitting import Part

# A processor begins so many events a cycle, in their order, and none before the one so many
# back has ended. Of two orders of the PMSM with 1, 2, 3 and 10 observers, and with noise,
# this takes the one that runs faster on AVX2.
RATE = 3.0
AHEAD = 100
STEPS = 3  # until one is like the next
LOAD, STORE = 4, 1  # cycles


def cycles(loop: Loop, events: Sequence[Event[Part]]) -> float:
    """Of one step among many, each of which waits for the carry of the one before."""
    read = {a for e in events if e.instruction for a in e.instruction.args}
    inputs = carries(loop.graph, {a.number for a in read})
    entry = {number: loop.carry[i] for i, number in inputs.items()}
    before = {a: Part(entry[a.number], a.place) for a in read if a.number in entry}
    began = ended = start = 0.0
    order: collections.deque[float] = collections.deque(maxlen=AHEAD)
    last: dict[Part, float] = {}
    for _ in range(STEPS):
        start, ready = ended, {}
        for event in events:
            if event.action in ("free", "drop"):
                continue
            began += 1 / RATE
            if len(order) == AHEAD:
                began = max(began, order[0])
            value, instruction, done = event.value, event.instruction, began
            if instruction is None:
                done = max(began, ready.get(value, 0.0)) + (
                    LOAD if event.action == "load" else STORE
                )
            else:
                for a in instruction.args:
                    done = max(done, ready.get(a, 0.0), last.get(before.get(a, a), 0.0))
                done += LATENCY.get(instruction.op, 1)
            if event.action != "store":
                ready[value] = done
            ended = max(ended, done)
            order.append(ended)
        last = ready
    return ended - start
