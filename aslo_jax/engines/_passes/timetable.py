"""What a step needs and is the same for all lanes: computed for all steps beforehand
(precomputation of what is uniform over the vector: uniformity analysis and hoisting).

Worth 6 to 7 % on the double integrator with noise, 1 to 10 % on the ball and beam, nothing
certain on the motor and the WRIM, measured by `benchmarks ablation` on Zen 4, with
registers of 64 bytes and of 32.
"""

import dataclasses

import numpy as np

from ..._ir.loop import Loop, Tables, uniform
from ..._ir.rewrite import pruned, rebuilt


def timetabled(loop: Loop) -> Loop:
    """The loop with an input for each value that its steps need and that is the same for
    all lanes, with the tables that make these."""
    graph, step, alike = loop.graph, loop.of_a_step(), uniform(loop)
    timed: set[int] = set()  # functions of time and of what is shared
    later: set[int] = set()  # also of what is carried
    fixed: set[int] = set()  # of what is shared alone
    for number in step:
        node = graph.nodes[number]
        if node.op == "input":
            kind, i = node.data
            if kind == "step":
                timed.add(number)
            elif kind == "shared":
                fixed.add(number)
            elif kind == "carry" and i in alike:
                later.add(number)
        elif fixed.issuperset(node.args):
            fixed.add(number)
        elif all(a in timed or a in fixed for a in node.args):
            timed.add(number)
        elif all(a in timed or a in fixed or a in later for a in node.args):
            later.add(number)
    used = {n for i, n in enumerate(loop.carry) if i not in alike} | set(loop.record)
    for number in step:
        if number not in timed and number not in later:
            used.update(graph.nodes[number].args)
    first = [n for n in step if n in timed and n in used]
    second = [n for n in step if n in later and n in used]
    new = {
        n: graph.input(graph.dtype(n), ("time", k)) for k, n in enumerate([*first, *second])
    }
    beside = along = None
    if first:
        index = graph.input(np.int64, ("lane", 0))
        moved = rebuilt(graph, first, {graph.input(np.int64, ("step", 0)): index})
        beside = Loop(graph, (), (), final=tuple(moved[n] for n in first))
    if second:
        alone = dataclasses.replace(loop, first=(), final=(), branches=())
        along = pruned(dataclasses.replace(alone, record=tuple(second)))
    # What is final follows from the last carry, after all of the times.
    found = rebuilt(graph, [*loop.carry, *loop.record], new)
    rest = dataclasses.replace(
        loop,
        carry=tuple(found[n] for n in loop.carry),
        record=tuple(found[n] for n in loop.record),
        branches=tuple(found[n] for n in loop.branches if n in found),
    )
    return dataclasses.replace(pruned(rest), tables=Tables(beside, along))
