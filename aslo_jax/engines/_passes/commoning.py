"""What the end of a step has computed is not computed again at the start of the next
(predictive commoning).

Worth 2 to 25 % on four plants (on the double integrator from -4 to 11 %), measured by
`benchmarks ablation` on Zen 4, with registers of 64 bytes and of 32.
"""

import dataclasses
from collections.abc import Iterable

from ..._ir.graph import Graph
from ..._ir.loop import Loop
from ..._ir.rewrite import carries, rebuilt, replaced
from .unswitching import always

# Operations that a value must take to be worth a place in memory, and those of some.
WORTH = 3
COSTLY = {"div": 8, "sqrt": 8}


def kept(loop: Loop) -> Loop:
    """What a step computes from its carry alone, and the step before has computed from
    the same values at its end, becomes a further entry of the carry."""
    graph = loop.graph
    step = graph.reachable(list(loop.carry))
    known = set(step)
    later = _later(loop, step)
    worth = _work(graph, step)
    again = {
        n for n in step if later.get(n) in known and later[n] != n and worth[n] >= WORTH
    }
    chosen_later = _of_chosen(loop, step, known, worth)
    again |= set(chosen_later)
    later |= chosen_later
    if loop.branches:
        # What one branch alone needs is not kept where it would take work in the others.
        ever = always(loop)
        again = {n for n in again if n in ever or later[n] in ever}
    chosen: dict[int, int] = {}
    begin, carry = list(loop.begin), list(loop.carry)
    now = carries(graph, [*step, *graph.reachable([*loop.record, *loop.final])])
    first = rebuilt(graph, again, {n: loop.begin[i] for i, n in now.items()})
    for number in _outermost(graph, loop.carry, again):
        entry = graph.input(graph.dtype(number), ("carry", len(carry)))
        chosen[number] = entry
        begin.append(first[number])
        carry.append(later[number])
    return replaced(
        dataclasses.replace(loop, begin=tuple(begin), carry=tuple(carry)), chosen
    )


def _later(loop: Loop, step: list[int]) -> dict[int, int]:
    """The nodes of the values that functions of the carry will have in the next step."""
    graph, later = loop.graph, {}
    for number in step:
        node = graph.nodes[number]
        if node.op == "input":
            kind, i = node.data
            if kind in ("shared", "lane"):
                later[number] = number
            elif kind == "carry":
                later[number] = loop.carry[i]
        elif all(a in later for a in node.args):
            later[number] = graph.again(number, tuple(later[a] for a in node.args))
    return later


def _of_chosen(
    loop: Loop, step: list[int], known: set[int], worth: dict[int, int]
) -> dict[int, int]:
    """The same for costly functions of a single entry of the carry that a step chooses from
    two values, where it has computed the function of both: the choice of these."""
    graph, later = loop.graph, {}
    only: dict[int, int | None] = {}  # the one entry, none (-1), or several (None)
    for number in step:
        node = graph.nodes[number]
        if node.op == "input":
            kind, i = node.data
            only[number] = i if kind == "carry" else None if kind != "lane" else -1
        else:
            found = {only[a] for a in node.args} - {-1}
            only[number] = found.pop() if len(found) == 1 else None if found else -1
    for number in step:
        i = only[number]
        if i is None or i < 0 or worth[number] < COSTLY["div"]:
            continue
        choice = graph.nodes[loop.carry[i]]
        if choice.op == "select":
            entry = graph.input(choice.dtype, ("carry", i))
            which, *values = choice.args
            values = [rebuilt(graph, [number], {entry: v})[number] for v in values]
            if known.issuperset(values):
                later[number] = graph.select(which, *values)
    return later


def _work(graph: Graph, step: list[int]) -> dict[int, int]:
    """About how many operations each node takes that change over time, at most some."""
    work: dict[int, int] = {}
    for number in step:
        node = graph.nodes[number]
        if node.op in ("const", "input"):
            work[number] = 0
        else:
            total = COSTLY.get(node.op, 1) + sum(work[a] for a in set(node.args))
            work[number] = min(total, 1000)
    return work


def _outermost(graph: Graph, roots: Iterable[int], chosen: set[int]) -> list[int]:
    """Those of the chosen nodes that the roots reach without passing another one."""
    found, seen, left = [], set(), list(roots)
    while left:
        number = left.pop()
        if number in seen:
            continue
        seen.add(number)
        if number in chosen:
            found.append(number)
        else:
            left += graph.nodes[number].args
    return sorted(found)
