"""How many cycles a step takes, estimated: to choose between orders of its operations."""

import collections
from collections.abc import Sequence

from .graph import Graph
from .order import LATENCY
from .reduce import carries
from .registers import Event

# A processor begins so many events a cycle, in their order, and none before the one so many
# back has ended. Of two orders of the PMSM with 1, 2, 5 and 10 observers, and with noise,
# this takes the one that runs faster on AVX2 with two vectors to a value.
RATE = 2.0
AHEAD = 100
STEPS = 3  # until one is like the next
LOAD, STORE = 4, 1  # cycles


def cycles(graph: Graph, events: Sequence[Event], carry: Sequence[int]) -> float:
    """Of one step among many, each of which waits for the carry of the one before."""
    inputs = carries(
        graph, {a for e in events if e.instruction for a in e.instruction.args}
    )
    entry = {number: i for i, number in inputs.items()}
    began = ended = before = 0.0
    order: collections.deque[float] = collections.deque(maxlen=AHEAD)
    last: dict[int, float] = {}
    for _ in range(STEPS):
        before, ready = ended, {}
        for event in events:
            if event.action == "free":
                continue
            began += 1 / RATE
            if len(order) == AHEAD:
                began = max(began, order[0])
            number, instruction, done = event.number, event.instruction, began
            if instruction is None:
                done = max(began, ready[number]) + (
                    LOAD if event.action == "load" else STORE
                )
            else:
                for a in instruction.args:
                    done = max(done, ready.get(a, 0.0), last.get(entry.get(a, -1), 0.0))
                done += LATENCY.get(instruction.op, 1)
            if event.action != "store":
                ready[number] = done
            ended = max(ended, done)
            order.append(ended)
        last = {i: ready.get(n, 0.0) for i, n in enumerate(carry)}
    return ended - before
