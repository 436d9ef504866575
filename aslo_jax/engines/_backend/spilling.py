"""Which values of a step wait in registers for their next use, and which in memory
(spilling, by Belady's rule).

LLVM allocates registers well in small loops. In a step of a thousand operations it stores
twice as many values as it must.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from ..._ir.selection import Instruction

Value = TypeVar("Value")  # a node of a graph, or a part of it


class Event(NamedTuple, Generic[Value]):
    """What comes next: `load` a value, `store` it and give its register away, `drop` it
    from its register, `do` an instruction, or `free` the place of what was stored."""

    action: str
    value: Value
    instruction: Instruction[Value] | None = None


# What no instruction makes waits in a register if it is needed again within so many, and a
# value that has a place in memory goes before one that has none and is needed so many times
# as late.
AGAIN = 12
CLEAN = 5


def planned(
    instructions: Sequence[Instruction[Value]], stored: Collection[Value], room: int
) -> Iterator[Event[Value]]:
    """The instructions with the loads and stores between them that keep the values that
    wait within `room`. What is `stored` when it is made has a place in memory already, and
    so have arguments that no instruction makes.

    Of several values the one goes that is needed last (after Belady,
    doi:10.1147/sj.52.0078).
    """
    uses: dict[Value, list[int]] = {x.result: [] for x in instructions}
    made = {x.result: time for time, x in enumerate(instructions)}
    for time, instruction in enumerate(instructions):
        for a in set(instruction.args):
            uses.setdefault(a, []).append(time)

    # When each value is needed next: for the first time after the instruction that has
    # been done last.
    coming = {value: iter(times) for value, times in uses.items()}
    following = {value: next(times, None) for value, times in coming.items()}
    held: set[Value] = set()
    in_memory = set(stored) | (uses.keys() - made.keys())

    def rank(value: Value, time: int) -> tuple[int, int]:
        then = following[value]
        assert then is not None, "what is needed no more does not wait"
        clean = CLEAN if value in in_memory else 1
        return (then - time) * clean, made.get(value, -1)

    def room_for(more: int, time: int, but: Collection[Value]) -> Iterator[Event[Value]]:
        """Values go until so many more are held than are now."""
        if len(held) + more <= room:
            return
        others = {v: rank(v, time) for v in held if v not in but}
        while others and len(held) + more > room:
            last = max(others, key=others.__getitem__)
            del others[last]
            held.remove(last)
            yield Event("drop" if last in in_memory else "store", last)
            in_memory.add(last)

    for time, instruction in enumerate(instructions):
        args = dict.fromkeys(instruction.args)
        for a in args:
            following[a] = next(coming[a], None)
        then = {a: following[a] for a in args}
        last_uses = dict.fromkeys(a for a in args if then[a] is None)
        loaded = [
            a
            for a, later in then.items()
            if a not in held
            and (a in made or (later is not None and later - time <= AGAIN))
        ]
        # An instruction reads one argument from memory itself; its result takes the place
        # of one in a register that is needed no more.
        read = len(args) - len(loaded) - len(held & args.keys())
        free = any(a in held or a in loaded for a in last_uses)
        # A loop takes all registers.
        more = room if instruction.op == "group" else max(read - 1, not free)
        yield from room_for(len(loaded) + more, time, args)
        for a in loaded:
            yield Event("load", a)
            held.add(a)
        yield Event("do", instruction.result, instruction)
        held.add(instruction.result)
        if following[instruction.result] is None:
            last_uses[instruction.result] = None
        held -= last_uses.keys()
        for v in last_uses:
            if v in made and v in in_memory and v not in stored:
                yield Event("free", v)
