"""Alike operations that a kernel does in one loop: products of the rows of a matrix with
one vector, and calls of one function."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ..._ir.graph import Graph
from ..._ir.node import LOOPED, Node


class Group(NamedTuple):
    """The nodes that one loop makes."""

    members: tuple[int, ...]

    def arrays(self, graph: Graph) -> list[tuple[int, ...]]:
        """What the loop reads, each an array of nodes: all rows of a matrix and the vector,
        one array for each argument of a function, or, of one with several results, those
        that change over time, and the others by their types."""
        args = [graph.nodes[n].args for n in self.members]
        if graph.nodes[self.members[0]].op == "call":
            return list(zip(*args, strict=True))
        if graph.nodes[self.members[0]].op == "part":
            function, _ = graph.nodes[self.members[0]].data
            moving, fixed = args[0][: function.moving], args[0][function.moving :]
            types = dict.fromkeys(graph.dtype(n) for n in fixed)
            return [
                moving,
                *(tuple(n for n in fixed if graph.dtype(n) == t) for t in types),
            ]
        inner = len(args[0]) // 2
        return [tuple(a for row in args for a in row[:inner]), args[0][inner:]]


class Phase(NamedTuple):
    """Operations that come after those of the phases before: first the `groups`, then the
    `rest`, which may need what these make."""

    groups: list[Group]
    rest: list[int]


def phases(
    nodes: Mapping[int, Node] | Sequence[Node],
    numbers: Iterable[int],
    varies: Mapping[int, tuple[bool, bool]],
) -> list[Phase]:
    """The nodes, arguments first, parted so that as many as may be are in one group: a node
    is in the phase that is the number of groups before it, one after the other."""
    numbers = list(numbers)
    levels = _levels(nodes, numbers)
    grouped: list[dict[Any, list[int]]] = [{}]
    rest: list[list[int]] = [[]]
    for number in numbers:
        node = nodes[number]
        looped = node.op in LOOPED
        level = levels[number]
        while level >= len(rest):
            grouped.append({})
            rest.append([])
        if looped:
            if node.op == "part":
                alike = id(node.data[0]), node.args
            else:
                alike = node.data if node.op == "call" else node.args[len(node.args) // 2 :]
            key = node.op, node.dtype, alike, varies[number][1]
            grouped[level].setdefault(key, []).append(number)
        else:
            rest[level].append(number)
    return [
        Phase([Group(tuple(members)) for members in groups.values()], numbers)
        for groups, numbers in zip(grouped, rest, strict=True)
    ]


def _levels(
    nodes: Mapping[int, Node] | Sequence[Node], numbers: list[int]
) -> dict[int, int]:
    """The phases of nodes. Sums of what functions make, one after the other, do not grow
    beside each other through the phases, but each in the last one that it may be in."""
    levels: dict[int, int] = {}
    for number in numbers:
        node = nodes[number]
        level = max((levels.get(a, 0) for a in node.args), default=0)
        levels[number] = level + (node.op in LOOPED)
    if not any(nodes[n].op == "part" for n in numbers):
        return levels
    most = dict.fromkeys(numbers, max(levels.values(), default=0))
    for number in reversed(numbers):
        node = nodes[number]
        if node.op in LOOPED:
            most[number] = levels[number]
        for a in node.args:
            if a in most:
                most[a] = min(most[a], most[number] - (node.op in LOOPED))
    return most


def entries(graph: Graph, groups: Iterable[Group]) -> set[int]:
    """The nodes in the arrays that groups read."""
    return {n for group in groups for array in group.arrays(graph) for n in array}


def needed_later(
    graph: Graph, given: Sequence[Phase], k: int, roots: Collection[int]
) -> list[int]:
    """The roots, and what the phases after the k-th need."""
    found = dict.fromkeys(roots)
    for phase in given[k + 1 :]:
        found |= dict.fromkeys(sorted(entries(graph, phase.groups)))
        found |= dict.fromkeys(a for n in phase.rest for a in graph.nodes[n].args)
    return list(found)
