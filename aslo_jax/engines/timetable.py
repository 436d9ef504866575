"""What depends on time alone: computed for all steps beforehand, beside each other."""

import numpy as np

from .loop import Loop
from .reduce import rebuilt, replaced


def timetable(loop: Loop) -> tuple[Loop, Loop | None]:
    """The loop with an input `("time", i)` for each value that its steps need and that
    depends on the time index and on what is shared only; and what makes these: a loop
    without steps, whose lanes are the steps, given their indices as `("lane", 0)`.

    Without such a value there is no second loop."""
    graph = loop.graph
    step = loop.of_a_step()
    timed: set[int] = set()  # functions of time and of what is shared
    fixed: set[int] = set()  # of the latter alone
    for number in step:
        node = graph.nodes[number]
        if node.op == "input":
            kind = node.data[0]
            (timed if kind == "step" else fixed if kind == "shared" else set()).add(number)
        elif fixed.issuperset(node.args):
            fixed.add(number)
        elif all(a in timed or a in fixed for a in node.args):
            timed.add(number)
    used = set(loop.carry) | set(loop.record)
    for number in step:
        if number not in timed:
            used.update(graph.nodes[number].args)
    wanted = [n for n in step if n in timed and n in used]
    if not wanted:
        return loop, None
    new = {n: graph.input(graph.dtype(n), ("time", k)) for k, n in enumerate(wanted)}
    index = graph.input(np.int64, ("lane", 0))
    moved = rebuilt(graph, wanted, {graph.input(np.int64, ("step", 0)): index})
    table = Loop(graph, (), (), final=tuple(moved[n] for n in wanted))
    return replaced(loop, new), table
