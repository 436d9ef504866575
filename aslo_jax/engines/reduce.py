"""A loop with less to do in a step: carries that are always equal are one, and what the end
of a step has computed is not computed again at the start of the next."""

import collections
import dataclasses
from collections.abc import Callable, Iterable, Mapping

from .graph import Graph
from .loop import Loop

# Operations that a value must take to be worth a place in memory, and those of some.
WORTH = 3
DEAR = {"div": 8, "sqrt": 8}


def reduced(loop: Loop) -> Loop:
    return lively(merged(lively(kept(lively(merged(loop))))))


def rebuilt(
    graph: Graph,
    roots: Iterable[int],
    new: Mapping[int, int] = {},
    other: Callable[[int, dict[int, int]], int | None] = lambda number, found: None,
) -> dict[int, int]:
    """The nodes that `roots` need, with some replaced by `new` ones, or by what `other`
    makes of one and of what has been found before it: from the old to the new."""
    found = dict(new)
    for number in graph.reachable(list(roots)):
        if number not in found:
            args, made = graph.nodes[number].args, other(number, found)
            if made is None:
                made = graph.again(number, tuple(found[a] for a in args))
            found[number] = made
    return found


def carries(graph: Graph, numbers: Iterable[int]) -> dict[int, int]:
    """The inputs from the carry among some nodes: from the place in it to the node."""
    found = {}
    for number in numbers:
        node = graph.nodes[number]
        if node.op == "input" and node.data[0] == "carry":
            found[node.data[1]] = number
    return found


def merged(loop: Loop) -> Loop:
    """Entries of the carry that begin alike and go on alike are one. Those that never
    change are what they begin with.

    The coarsest such partition: all that begin alike are taken as one, and parted where
    one step takes them apart, until none is."""
    graph = loop.graph
    inputs = carries(graph, loop.needed())
    group = [(graph.dtype(n), n) for n in loop.begin]
    while True:
        leader = {g: i for i, g in reversed(list(enumerate(group)))}
        first = [leader[g] for g in group]
        new = {}
        for i, number in inputs.items():
            entry = graph.input(graph.dtype(number), ("carry", first[i]))
            new[number] = entry
        found = rebuilt(graph, loop.carry, new)
        following = [(f, found[n]) for f, n in zip(first, loop.carry, strict=True)]
        if len(set(following)) == len(set(group)):
            break
        group = following
    for i, number in inputs.items():
        if found[loop.carry[first[i]]] == new[number]:
            new[number] = loop.begin[i]
    return replaced(loop, new)


def replaced(loop: Loop, new: Mapping[int, int]) -> Loop:
    """The loop with some nodes of a step replaced."""
    return mapped(loop, rebuilt(loop.graph, moving_roots(loop), new))


def moving_roots(loop: Loop) -> list[int]:
    return [*loop.carry, *loop.record, *loop.final]


def counted(loop: Loop) -> collections.Counter[int]:
    """How often each node of a step and of its end is needed."""
    graph, roots = loop.graph, moving_roots(loop)
    uses = collections.Counter(roots)
    uses.update(a for n in graph.reachable(roots) for a in graph.nodes[n].args)
    return uses


def mapped(loop: Loop, found: Mapping[int, int]) -> Loop:
    """The loop with what has been found for the nodes of a step and of its end."""
    return dataclasses.replace(
        loop,
        carry=tuple(found[n] for n in loop.carry),
        record=tuple(found[n] for n in loop.record),
        final=tuple(found[n] for n in loop.final),
    )


def lively(loop: Loop) -> Loop:
    """Without the entries of the carry that nothing needs, the others numbered anew."""
    graph = loop.graph
    alive: set[int] = set()
    more = carries(graph, graph.reachable([*loop.record, *loop.final]))
    while more:
        alive |= set(more)
        found = carries(graph, graph.reachable([loop.carry[i] for i in more]))
        more = {i: n for i, n in found.items() if i not in alive}
    kept = sorted(alive)
    small = dataclasses.replace(
        loop,
        begin=tuple(loop.begin[i] for i in kept),
        carry=tuple(loop.carry[i] for i in kept),
    )
    place = {old: k for k, old in enumerate(kept)}
    new = {
        number: graph.input(graph.dtype(number), ("carry", place[i]))
        for i, number in carries(graph, small.needed()).items()
    }
    return replaced(small, new)


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
    """The same for dear functions of a single entry of the carry that a step chooses from
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
        if i is None or i < 0 or worth[number] < DEAR["div"]:
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
            total = DEAR.get(node.op, 1) + sum(work[a] for a in set(node.args))
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
