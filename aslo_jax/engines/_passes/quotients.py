"""Comparisons of quotients with constants, without the division (strength reduction:
division elimination).

Worth 3 to 6 % on the double integrator, 0 to 4 % on the motor, nothing certain elsewhere,
measured by `benchmarks ablation` on Zen 4, with registers of 64 bytes and of 32.
"""

from collections.abc import Mapping

from ..._ir.graph import Graph
from ..._ir.loop import Loop
from ..._ir.rewrite import counted, mapped, moving_roots, rebuilt


def undivided(loop: Loop) -> Loop:
    """The loop with `n / x > k` as `x >= 0` and `x < n / k`, for positive constants n and
    k, where nothing else needs the quotient, or what chooses between it and a constant.
    They differ by rounding, and for a negative zero x, only."""
    graph, uses = loop.graph, counted(loop)

    def compared(number: int, found: Mapping[int, int]) -> int | None:
        node = graph.nodes[number]
        if node.op not in ("gt", "lt"):
            return None
        above, below = node.args if node.op == "gt" else node.args[::-1]
        return _greater(graph, uses, found, above, below)

    return mapped(loop, rebuilt(graph, moving_roots(loop), other=compared))


def _greater(
    graph: Graph, uses: Mapping[int, int], found: Mapping[int, int], number: int, bound: int
) -> int | None:
    """Whether a node is greater than a constant, where that takes no division."""
    node, value = graph.nodes[number], graph.value(bound)
    if value is None or value <= 0 or uses[number] > 1:
        return None
    if node.op == "select":
        which, chosen, other = node.args
        least = graph.value(other)
        above = _greater(graph, uses, found, chosen, bound)
        if above is None or least is None or least > value:
            return None
        return graph.op("and", found[which], above)
    if node.op != "div" or node.dtype.kind != "f" or graph.value(node.args[0]) is None:
        return None
    over, under = (found[a] for a in node.args)
    most = graph.op("div", over, bound)
    if not 0 < graph.value(most) < float("inf"):
        return None
    zero = graph.const(0, node.dtype)
    return graph.op("and", graph.op("ge", under, zero), graph.op("lt", under, most))
