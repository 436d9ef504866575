"""What passes over a loop have in common: nodes rebuilt on others, uses counted, and what
nothing needs removed (dead-code elimination)."""

import collections
import dataclasses
from collections.abc import Callable, Iterable, Mapping

from .graph import Graph
from .loop import Loop, Switch


def rebuilt(
    graph: Graph,
    roots: Iterable[int],
    new: Mapping[int, int] = {},
    other: Callable[[int, dict[int, int]], int | None] = lambda number, found: None,
) -> dict[int, int]:
    """The nodes that `roots` need, with some replaced by `new` ones, or by what `other`
    makes of one and of what has been found before it: from the old to the new."""
    found = dict(new)
    old, now = (), ()  # the results of a function share their arguments
    for number in graph.reachable(list(roots)):
        if number not in found:
            args, made = graph.nodes[number].args, other(number, found)
            if made is None:
                if args is not old or not args:
                    old, now = args, tuple(found[a] for a in args)
                made = graph.again(number, now)
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


def replaced(loop: Loop, new: Mapping[int, int]) -> Loop:
    """The loop with some nodes of a step replaced."""
    return mapped(loop, rebuilt(loop.graph, moving_roots(loop), new))


def moving_roots(loop: Loop) -> list[int]:
    ends = [*loop.carry, *loop.record, *loop.final]
    return [*ends, *loop.branches, *loop.conditions]


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
        branches=tuple(found[n] for n in loop.branches),
        switches=tuple(Switch(found[n], usual) for n, usual in loop.switches),
    )


def alive(loop: Loop) -> list[int]:
    """The entries of the carry that something needs."""
    graph, kept = loop.graph, set[int]()
    more = carries(graph, graph.reachable([*loop.record, *loop.final, *loop.conditions]))
    while more:
        kept |= set(more)
        found = carries(graph, graph.reachable([loop.carry[i] for i in more]))
        more = {i: n for i, n in found.items() if i not in kept}
    return sorted(kept)


def pruned(loop: Loop) -> Loop:
    """Without the entries of the carry that nothing needs, the others numbered again, and
    without the branches that no next carry depends on."""
    graph, whole = loop.graph, set(loop.graph.reachable(list(loop.carry)))
    branches = dict.fromkeys(n for n in loop.branches if n in whole)
    loop = dataclasses.replace(loop, branches=tuple(branches))
    kept = alive(loop)
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
