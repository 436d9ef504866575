"""Choices between values where it is known which one is taken (correlated value
propagation).

Worth -1 to 6 % on four plants, most on the motor and the WRIM, measured by `benchmarks
ablation` on Zen 4, with registers of 64 bytes and of 32.
"""

from collections.abc import Iterator

from ..._ir.graph import Graph
from ..._ir.loop import Loop
from ..._ir.node import BOOL, COMPARISONS
from ..._ir.rewrite import mapped, moving_roots, rebuilt

Fact = tuple[int, bool]  # a condition, and whether it holds

# Of reals, what may be done with any value at all where the result does not show: no index
# is made of it, and no division of whole numbers.
HARMLESS = {"add", "sub", "mul", "div", "neg", "abs", "sqrt", "fma", "select"}
HARMLESS |= {*COMPARISONS}


def decided(loop: Loop) -> Loop:
    """The loop without choices whose outcome shows only where their condition is known, as
    that of `where(x > 0, 1 / where(x > 0, x, 1), 0)` within the other one."""
    graph, roots = loop.graph, moving_roots(loop)
    known: dict[int, frozenset[Fact]] = dict.fromkeys(roots, frozenset())
    taken = {}
    for number in reversed(graph.reachable(roots)):
        facts, node = known[number], graph.nodes[number]
        if node.op == "select" and node.dtype.kind == "f":
            which, on_true, on_false = node.args
            if (which, True) in facts:
                taken[number] = on_true
            elif (which, False) in facts:
                taken[number] = on_false
        for a, more in _shown(graph, number, facts):
            known[a] = known[a] & more if a in known else more
    same = lambda number, found: found.get(taken.get(number))
    return mapped(loop, rebuilt(graph, roots, other=same))


def _shown(
    graph: Graph, number: int, facts: frozenset[Fact]
) -> Iterator[tuple[int, frozenset[Fact]]]:
    """The arguments of a node, and what is known where their values show."""
    node = graph.nodes[number]
    logical = node.dtype == BOOL and node.op in ("and", "or")
    if node.op == "select":
        which, on_true, on_false = node.args
        yield which, facts
        yield on_true, facts | _facts(graph, which, True)
        yield on_false, facts | _facts(graph, which, False)
    elif logical:
        # The second one shows where the first does not decide.
        first, second = node.args
        yield first, facts
        yield second, facts | _facts(graph, first, node.op == "and")
    else:
        harmless = node.op in HARMLESS or node.dtype == BOOL
        for a in node.args:
            yield a, facts if harmless else frozenset()


def _facts(graph: Graph, which: int, holds: bool) -> frozenset[Fact]:
    """What follows from a condition: itself, and what it joins."""
    node, found = graph.nodes[which], {(which, holds)}
    if node.dtype == BOOL and node.op == ("and" if holds else "or"):
        return frozenset(found).union(*(_facts(graph, a, holds) for a in node.args))
    if node.dtype == BOOL and node.op == "not":
        return frozenset(found) | _facts(graph, node.args[0], not holds)
    return frozenset(found)
