"""A step for several registers of lanes, which take turns (interleaving of unrolled vector
iterations).

Operation by operation, each on all registers, would need room for the values of all at
once. Turn by turn, each register has most of the room, and the processor still finds the
operations of several to do at a time: it looks further ahead than a turn is long.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from ..._ir.selection import Instruction


class Part(NamedTuple):
    """The lanes of a value that are in one register, of as many as its type needs."""

    number: int
    place: int


def in_parts(
    instructions: Sequence[Instruction[int]],
    counts: Mapping[int, int],
    alike: Collection[int] = (),
    turn: int = 36,
) -> list[Instruction[Part]]:
    """The instructions on parts of values, of which there are `counts`, powers of two, also
    for arguments that no instruction makes. An argument with more parts than the result
    is given by several.

    In a `turn` there are half as many instructions or half as many more: its end is where
    the fewest values wait."""
    most = max((counts[x.result] for x in instructions), default=1)

    def given(x: Instruction[int], place: int) -> Iterator[Part]:
        for a in x.args:
            if a in alike:
                yield Part(a, 0)
            else:
                yield from parts_of(a, place, counts[x.result], counts[a])

    found = []
    for some in _turns(instructions, counts, turn):
        for k in range(most):
            for x in some:
                count = counts[x.result]
                if k % (most // count) == 0:
                    result = Part(x.result, k * count // most)
                    found.append(Instruction(result, x.op, tuple(given(x, result.place))))
    return found


def parts_of(number: int, place: int, count: int, own: int) -> list[Part]:
    """Of a value with `own` parts, those with the lanes of one of `count`."""
    first, many = place * own // count, max(own // count, 1)
    return [Part(number, first + k) for k in range(many)]


def _turns(
    instructions: Sequence[Instruction[int]], counts: Mapping[int, int], turn: int
) -> Iterator[Sequence[Instruction[int]]]:
    """The instructions, cut where few values wait, and before one that needs all parts of
    a value of the turn."""
    waiting = _waiting(instructions)
    made = {x.result: time for time, x in enumerate(instructions)}
    first = 0
    while first < len(instructions):
        end = len(instructions)
        if end - first > 3 * turn // 2:
            ends = range(first + turn // 2, first + 3 * turn // 2)
            end = min(ends, key=lambda t: (waiting[t], abs(t - first - turn)))
        for time in range(first + 1, end):
            x = instructions[time]
            wider = (a for a in x.args if counts[a] > counts[x.result])
            if any(made.get(a, -1) >= first for a in wider):
                end = time
                break
        yield instructions[first:end]
        first = end


def _waiting(instructions: Sequence[Instruction[int]]) -> list[int]:
    """Before each instruction, how many values that others have made wait for a use."""
    last = {a: time for time, x in enumerate(instructions) for a in x.args}
    change = [0] * (len(instructions) + 1)
    for time, x in enumerate(instructions):
        if x.result in last:
            change[time + 1] += 1
            change[last[x.result] + 1] -= 1
    total, found = 0, []
    for step in change:
        total += step
        found.append(total)
    return found
