"""Which operations of a graph become one instruction (instruction selection): products that
are added at once."""

from collections.abc import Collection, Iterable
from typing import Generic, NamedTuple, TypeVar

from .graph import Graph

Value = TypeVar("Value")  # a node of a graph, or a part of it


class Instruction(NamedTuple, Generic[Value]):
    """`op` on some values. Besides the operations of a graph there are `muladd` (`a b +
    c`), `mulsub` (`a b - c`) and `submul` (`c - a b`)."""

    result: Value
    op: str
    args: tuple[Value, ...]


def selected(
    graph: Graph, numbers: Iterable[int], results: Collection[int]
) -> list[Instruction[int]]:
    """The operations of some nodes, in their order. A real product that only one sum or
    difference needs, and that is none of the `results`, is a part of it."""
    numbers = list(numbers)
    inside, uses = set(numbers), dict.fromkeys(numbers, 0)
    for number in numbers:
        for a in graph.nodes[number].args:
            if a in inside:
                uses[a] += 1
    parts: set[int] = set()

    def part(number: int) -> bool:
        node = graph.nodes[number]
        single = node.op == "mul" and uses.get(number) == 1 and number not in results
        return single and number not in parts

    found = []
    for number in numbers:
        node = graph.nodes[number]
        op, args = node.op, node.args
        if op in ("const", "input"):
            continue
        if op in ("add", "sub") and node.dtype.kind == "f":
            first, second = args
            if part(first):
                op = "muladd" if op == "add" else "mulsub"
                args = (*graph.nodes[first].args, second)
                parts.add(first)
            elif part(second):
                op = "muladd" if op == "add" else "submul"
                args = (*graph.nodes[second].args, first)
                parts.add(second)
        found.append(Instruction(number, op, args))
    return [x for x in found if x.result not in parts]
