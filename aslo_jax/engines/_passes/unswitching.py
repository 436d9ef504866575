"""A body for what a step usually does, and one for what it rarely does (loop unswitching):
what only the latter needs takes no time in the former."""

import dataclasses

from ..._ir.graph import Graph
from ..._ir.loop import Loop, Switch, varying
from ..._ir.node import LOOPED
from ..._ir.rewrite import moving_roots
from ..._ir.specialisation import specialised

# A body pays if it saves such a share of a step, and so many operations: two more bodies
# are compiled, and every step finds out which one it takes. One more condition pays if it
# saves so many again.
SHARE = 0.2
LEAST = 40
TRIALS = 16  # of branches, each of which takes two rewritings
COSTLY = {"div": 8, "sqrt": 8, "table": 8}  # operations that take as long as some


def unswitched(loop: Loop) -> Loop:
    """The loop with switches: the conditions of its branches that together save most, each
    as it is where the step takes less. Their values are needed before all else, and so are
    no part of a saving."""
    graph = loop.graph
    if any(graph.nodes[n].op in LOOPED for n in loop.of_a_step()):
        return dataclasses.replace(loop, branches=())  # what loops make has one place
    step = varying(graph, graph.reachable(list(loop.carry)))
    moving = {n for n, (over_time, _) in step.items() if over_time}
    left = [n for n in loop.branches if n in step and graph.value(n) is None][:TRIALS]
    whole = work = _work(graph, moving)
    switches: list[Switch] = []
    while left:
        trials = [
            (_usual(loop, [*switches, Switch(n, holds)], moving), n, holds)
            for n in left
            for holds in (True, False)
        ]
        least, number, holds = min(trials)
        if work - least < max(0.0 if switches else SHARE * whole, LEAST):
            break
        work = least
        switches.append(Switch(number, holds))
        left.remove(number)
    return dataclasses.replace(loop, branches=(), switches=tuple(switches))


def always(loop: Loop) -> set[int]:
    """What a step computes whatever the outcomes of its branches."""
    graph, roots = loop.graph, moving_roots(loop)
    found = set(graph.reachable(roots))
    for branch in loop.branches[:TRIALS]:
        for holds in (True, False):
            found &= specialised(graph, roots, {branch: holds}).reached
        found |= set(graph.reachable([branch]))
    return found


def _usual(loop: Loop, switches: list[Switch], moving: set[int]) -> int:
    """The work of the switches, and of the body where all are as usual."""
    graph = loop.graph
    body = specialised(graph, loop.carry, {s.condition: s.usual for s in switches}).nodes
    first = moving.intersection(graph.reachable([s.condition for s in switches]))
    return _work(graph, moving & body.keys()) + _work(graph, first)


def _work(graph: Graph, numbers: set[int]) -> int:
    ops = (graph.nodes[n].op for n in numbers)
    return sum(COSTLY.get(op, 1) for op in ops if op not in ("const", "input"))
