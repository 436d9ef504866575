"""Sums of two entries of a carry, made at the end of the step before the one that needs
them: there is less to carry."""

import dataclasses
from collections.abc import Mapping

from ..ir.graph import Graph
from ..ir.loop import Loop, varying
from ..ir.rewrite import carries, counted, mapped, moving_roots, pruned, rebuilt


def retimed(loop: Loop) -> Loop:
    """The loop with one entry of its carry for every sum of two, each perhaps times a
    factor that does not change over time, that nothing else needs."""
    while sums := _sums_of_two(loop):
        loop = pruned(_early(loop, sums))
    return loop


def _sums_of_two(loop: Loop) -> dict[int, int]:
    """Sums of a step of two entries that only they need: the first of the two."""
    graph, uses, found = loop.graph, counted(loop), {}
    step = graph.reachable(list(loop.carry))
    varies = varying(graph, step)
    for number in step:
        node = graph.nodes[number]
        if node.op in ("add", "sub") and node.dtype.kind == "f":
            first, second = (_entry(graph, uses, varies, a) for a in node.args)
            if first is not None and second is not None:
                found[number] = first
    return found


def _entry(
    graph: Graph,
    uses: Mapping[int, int],
    varies: Mapping[int, tuple[bool, bool]],
    number: int,
) -> int | None:
    """The entry of the carry that a node is, or is a multiple of, and that is needed only
    for that."""
    node = graph.nodes[number]
    if uses[number] != 1:
        return None
    if node.op == "input" and node.data[0] == "carry":
        return node.data[1]
    if node.op == "mul":
        for a, b in (node.args, node.args[::-1]):
            over_time, _ = varies[b]
            if not over_time:
                return _entry(graph, uses, varies, a)
    return None


def _early(loop: Loop, sums: Mapping[int, int]) -> Loop:
    """With entries of the carry replaced by the nodes that are made of them."""
    graph = loop.graph
    inputs = carries(graph, graph.reachable(list(sums)))
    made = [
        rebuilt(graph, sums, {n: values[i] for i, n in inputs.items()})
        for values in (loop.begin, loop.carry)
    ]
    begin, carry = list(loop.begin), list(loop.carry)
    new = {}
    for number, entry in sums.items():
        begin[entry], carry[entry] = (found[number] for found in made)
        new[number] = graph.input(graph.dtype(number), ("carry", entry))
    loop = dataclasses.replace(loop, begin=tuple(begin), carry=tuple(carry))
    return mapped(loop, rebuilt(graph, moving_roots(loop), new))
