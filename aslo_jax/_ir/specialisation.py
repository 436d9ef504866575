"""What is left of a step where it is known whether some conditions hold
(specialisation: constants propagated through choices, and through these only)."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from .graph import Graph
from .node import BOOL, Node


class Special(NamedTuple):
    """The `nodes` that are needed, by their numbers in the graph, on arguments that are
    chosen already; the one that is the `same` as each node was; and what is `reached` on
    the way to them: what is chosen from stands for the choice."""

    nodes: Mapping[int, Node]
    same: Mapping[int, int]
    reached: set[int]


def specialised(
    graph: Graph, roots: Iterable[int], conditions: Mapping[int, bool]
) -> Special:
    """What `roots` need where it is known whether some conditions hold.

    No operation becomes another one, and no two become one: where products and sums are
    rounded at once depends on who else needs them, and a step must leave the same bits
    whether it was known beforehand what it chooses or not."""
    roots = list(roots)
    order = graph.reachable(roots)
    same: dict[int, int] = {}
    for number in order:
        known = _chosen(graph, graph.nodes[number], same)
        same[number] = number if known is None else known
        if number in conditions:
            same[number] = graph.const(conditions[number], BOOL)
    nodes: dict[int, Node] = {}
    reached, left = set(roots), [same[n] for n in roots]
    while left:
        number = left.pop()
        if number not in nodes:
            node = graph.nodes[number]
            args = tuple(same[a] for a in node.args)
            nodes[number] = node._replace(args=args)
            reached |= {number, *node.args}
            left += args
    return Special({n: nodes[n] for n in sorted(nodes)}, same, reached)


def _chosen(graph: Graph, node: Node, same: Mapping[int, int]) -> int | None:
    """The node that is the same as a choice or a boolean whose outcome is known."""
    args = [same[a] for a in node.args]
    values = [graph.value(a) if graph.dtype(a) == BOOL else None for a in args]
    if node.op == "select" and values[0] is not None:
        return args[1] if values[0] else args[2]
    if node.dtype != BOOL:
        return None
    if node.op == "not" and values[0] is not None:
        return graph.const(not values[0], BOOL)
    if node.op in ("and", "or"):
        for value, constant, other in zip(values, args, args[::-1], strict=True):
            if value is not None:
                return other if bool(value) == (node.op == "and") else constant
    return None
