"""Alike operations that a kernel does in one loop: products of the rows of a matrix with
one vector, and calls of one function."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from .._ir.graph import Graph, Node

LOOPED = ("dot", "call")


class Group(NamedTuple):
    """The nodes that one loop makes."""

    members: tuple[int, ...]

    def arrays(self, graph: Graph) -> list[tuple[int, ...]]:
        """What the loop reads, each an array of nodes: all rows of a matrix and the vector,
        or one array for each argument of a function."""
        args = [graph.nodes[n].args for n in self.members]
        if graph.nodes[self.members[0]].op == "call":
            return list(zip(*args, strict=True))
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
    levels: dict[int, int] = {}
    grouped: list[dict[Any, list[int]]] = [{}]
    rest: list[list[int]] = [[]]
    for number in numbers:
        node = nodes[number]
        looped = node.op in LOOPED
        level = max((levels.get(a, 0) for a in node.args), default=0) + looped
        levels[number] = level
        if level == len(rest):
            grouped.append({})
            rest.append([])
        if looped:
            alike = node.data if node.op == "call" else node.args[len(node.args) // 2 :]
            key = node.op, node.dtype, alike, varies[number][1]
            grouped[level].setdefault(key, []).append(number)
        else:
            rest[level].append(number)
    return [
        Phase([Group(tuple(members)) for members in groups.values()], numbers)
        for groups, numbers in zip(grouped, rest, strict=True)
    ]


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
