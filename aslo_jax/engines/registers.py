"""Which values of a step wait in registers for their next use, and which in memory.

LLVM allocates registers well in small loops. In a step of a thousand operations it stores
twice as many values as it must.
"""

import bisect
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from .graph import Graph


class Instruction(NamedTuple):
    """`op` on some nodes, whose result is the node `number`. Besides the operations of a
    graph there are `muladd` (`a b + c`), `mulsub` (`a b - c`) and `submul` (`c - a b`)."""

    number: int
    op: str
    args: tuple[int, ...]


class Event(NamedTuple):
    """What comes next: `load` or `store` a value, `do` an instruction, or `free` the place
    of a value that was stored."""

    action: str
    number: int
    instruction: Instruction | None = None


def selected(
    graph: Graph, numbers: Iterable[int], results: Collection[int]
) -> list[Instruction]:
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
    return [x for x in found if x.number not in parts]


def planned(
    instructions: Sequence[Instruction],
    sizes: Mapping[int, int],
    stored: Collection[int],
    room: int,
) -> Iterator[Event]:
    """The instructions with the loads and stores between them that keep the values that
    wait within `room`, the sum of their `sizes`. What is `stored` when it is made has a
    place in memory already. Arguments that no instruction makes do not count.

    Of several values the one goes that is needed last (Belady, doi:10.1147/sj.52.0078).
    """
    uses: dict[int, list[int]] = {x.number: [] for x in instructions}
    for time, instruction in enumerate(instructions):
        for a in set(instruction.args) & uses.keys():
            uses[a].append(time)

    def following(number: int, time: int) -> int | None:
        later = bisect.bisect_right(uses[number], time)
        return uses[number][later] if later < len(uses[number]) else None

    held: set[int] = set()
    in_memory = set(stored)
    for time, instruction in enumerate(instructions):
        for a in dict.fromkeys(instruction.args):
            if a in uses and a not in held:
                yield Event("load", a)
                held.add(a)
        yield Event("do", instruction.number, instruction)
        held.add(instruction.number)
        then = {n: following(n, time) for n in held}
        done = sorted(n for n in held if then[n] is None)
        held -= set(done)
        for n in done:
            if n in in_memory and n not in stored:
                yield Event("free", n)
        while sum(sizes[n] for n in held) > room:
            last = max(held, key=lambda n: (then[n], n))
            held.remove(last)
            if last not in in_memory:
                yield Event("store", last)
                in_memory.add(last)
