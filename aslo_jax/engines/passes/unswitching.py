"""A body for each outcome of a condition of a step (loop unswitching): what one of them
alone needs takes no time in the others."""

import dataclasses

from ..ir.graph import Graph
from ..ir.loop import Loop, varying
from ..ir.rewrite import moving_roots
from ..ir.specialisation import specialised

# A body pays if it saves such a share of a step, and so many operations: two more bodies are
# compiled, and every step finds out which one it takes.
SHARE = 0.2
LEAST = 40
TRIALS = 16  # of branches, each of which takes two rewritings
DEAR = {"div": 8, "sqrt": 8, "table": 8}  # operations that take as long as some


def unswitched(loop: Loop) -> Loop:
    """The loop with the switch, among the conditions of its branches, that saves most, or
    with none. Its value is needed before all else, and so is not a part of a saving."""
    graph = loop.graph
    step = varying(graph, graph.reachable(list(loop.carry)))
    moving = {n for n, (over_time, _) in step.items() if over_time}
    given = [n for n in loop.branches if n in step and graph.value(n) is None][:TRIALS]
    whole = _work(graph, moving)
    savings = {n: whole - _least(loop, n, moving) for n in given}
    best = max(given, key=lambda n: savings[n], default=None)
    if best is not None and savings[best] < max(SHARE * whole, LEAST):
        best = None
    return dataclasses.replace(loop, branches=(), switch=best)


def always(loop: Loop) -> set[int]:
    """What a step computes whatever the outcomes of its branches."""
    graph, roots = loop.graph, moving_roots(loop)
    found = set(graph.reachable(roots))
    for branch in loop.branches[:TRIALS]:
        for holds in (True, False):
            found &= specialised(graph, roots, branch, holds).reached
        found |= set(graph.reachable([branch]))
    return found


def _least(loop: Loop, switch: int, moving: set[int]) -> int:
    """The work of the switch, and of the cheaper of its two bodies."""
    graph, roots = loop.graph, loop.carry
    bodies = (specialised(graph, roots, switch, holds).nodes for holds in (True, False))
    least = min(_work(graph, moving & body.keys()) for body in bodies)
    return least + _work(graph, moving.intersection(graph.reachable([switch])))


def _work(graph: Graph, numbers: set[int]) -> int:
    ops = (graph.nodes[n].op for n in numbers)
    return sum(DEAR.get(op, 1) for op in ops if op not in ("const", "input"))
