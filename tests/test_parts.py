"""Instructions for several registers of lanes, which take turns."""

import collections

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from aslo_jax._ir.selection import Instruction
from aslo_jax.engines._backend.splitting import Part, in_parts, parts_of


@st.composite
def programs(draw):
    """Instructions on the values from 100 on, in a random order in which arguments come
    first, of what came before and of two givens; and how many parts each value has."""
    count = draw(st.integers(1, 40))
    instructions = []
    for k in range(count):
        before = [0, 1, *range(100, 100 + k)]
        args = draw(st.lists(st.sampled_from(before[-8:]), min_size=1, max_size=3))
        instructions.append(Instruction(100 + k, "any", tuple(args)))
    order, left = [], list(instructions)
    while left:
        done = {0, 1, *(x.result for x in order)}
        ready = [x for x in left if done.issuperset(x.args)]
        order.append(draw(st.sampled_from(ready)))
        left.remove(order[-1])
    sizes = draw(st.sampled_from([(1,), (2,), (1, 2), (1, 2, 4), (2, 4)]))
    counts = {n: draw(st.sampled_from(sizes)) for n in (0, 1, *range(100, 100 + count))}
    return order, counts


def lanes(part, counts, most):
    """Of `most` pieces of the lanes, those of a part."""
    many = most // counts[part.number]
    return set(range(part.place * many, (part.place + 1) * many))


def checked(instructions, counts, turn=36):
    """The instructions in parts: each part of a result once, of the lanes that it has of
    each argument, and after them."""
    found = in_parts(instructions, counts, turn=turn)
    made = {x.result: x for x in instructions}
    most = max(counts.values())
    expected = {Part(n, k) for n in made for k in range(counts[n])}
    assert len(found) == len(expected) and {x.result for x in found} == expected
    done = set()
    for x in found:
        whole = made[x.result.number]
        assert x.op == whole.op
        args = collections.deque(x.args)
        mine = lanes(x.result, counts, most)
        for a in whole.args:
            many = max(counts[a] // counts[whole.result], 1)
            taken = [args.popleft() for _ in range(many)]
            assert {p.number for p in taken} == {a}
            assert taken == sorted(taken)
            assert mine <= set().union(*(lanes(p, counts, most) for p in taken))
            assert all(p in done for p in taken if a in made)
        assert not args
        done.add(x.result)
    return found


SLOW = [pytest.param(turn, marks=pytest.mark.slow) for turn in (2, 40)]


@pytest.mark.parametrize("turn", [5, *SLOW])
def test_every_part_is_made_once_after_its_arguments(turn):
    @settings(max_examples=150)
    @given(programs())
    def test(program):
        checked(*program, turn)

    test()


@pytest.mark.parametrize(
    "sizes", [(1, 2), (2, 1), (1, 4), (4, 1), (4, 2, 1), (1, 2, 4), (2, 1, 2), (1, 2, 1)]
)
def test_an_argument_may_have_more_parts_than_the_result_or_fewer(sizes):
    """A chain of values, the first of which is given or made of a given one."""
    for first in (0, 1):
        chain = [Instruction(k, "any", (k - 1,)) for k in range(first, len(sizes))]
        checked(chain, dict(enumerate(sizes)) | {-1: sizes[0]})


def test_a_sum_of_values_with_several_numbers_of_parts():
    """A mask of four registers chooses between two in one register each, and a value of
    two is added to what is cut from one."""
    counts = {1: 4, 2: 1, 3: 1, 4: 1, 5: 2, 6: 2}
    program = [
        *(Instruction(n, "any", (0,)) for n in (1, 2, 3)),
        Instruction(4, "select", (1, 2, 3)),
        Instruction(5, "any", (0,)),
        Instruction(6, "add", (5, 4)),
    ]
    found = checked(program, counts | {0: 4})
    by_part = {x.result: x for x in found}
    chosen = by_part[Part(4, 0)]
    assert chosen.args == (*(Part(1, k) for k in range(4)), Part(2, 0), Part(3, 0))
    assert by_part[Part(6, 1)].args == (Part(5, 1), Part(4, 0))


def test_the_parts_with_the_lanes_of_another():
    assert parts_of(7, 1, 2, 4) == [Part(7, 2), Part(7, 3)]
    assert parts_of(7, 3, 4, 2) == [Part(7, 1)]
    assert parts_of(7, 1, 2, 2) == [Part(7, 1)]
    assert parts_of(7, 0, 1, 4) == [Part(7, k) for k in range(4)]


def cuts(found):
    """Where the first register takes its turn again."""
    places = [x.result.place for x in found]
    return [k // 2 for k in range(1, len(found)) if places[k] < places[k - 1]]


def blocks(lengths):
    """Blocks of instructions that all need what is made first in their block, and the
    first two of which need the last one of the block before."""
    found = []
    for length in lengths:
        first = len(found)
        for k in range(length):
            before = len(found) - 1 if k > 1 else first - 1
            args = (before,) if k == 0 else (first, before)
            found.append(Instruction(len(found), "any", args))
    return found


@pytest.mark.parametrize("turn", [4, 12, 40])
def test_turns_end_where_few_values_wait(turn):
    """Between two blocks only one value waits, and within a block two."""
    lengths = [turn, turn + turn // 4, 3 * turn // 4, turn, turn // 2, turn]
    program = blocks(lengths)
    found = checked(program, dict.fromkeys(range(-1, len(program)), 2), turn)
    ends = [sum(lengths[: k + 1]) for k in range(len(lengths))]
    # What is left is no longer than one and a half turns, which takes the last two.
    assert cuts(found) == ends[:4]


def test_of_ends_that_are_alike_the_one_after_a_turn_is_taken():
    chain = [Instruction(k, "any", (k - 1,)) for k in range(41)]
    found = in_parts(chain, dict.fromkeys(range(-1, 41), 2), turn=10)
    assert cuts(found) == [10, 20, 30]
    short = in_parts(chain[:15], dict.fromkeys(range(-1, 15), 2), turn=10)
    assert cuts(short) == []
    first = [x.result for x in short[:15]]
    assert first == [Part(k, 0) for k in range(15)]


def test_instructions_in_single_registers_stay_as_they_are():
    program = [*blocks([30, 50, 70]), *(Instruction(k, "any", (-1,)) for k in (151, 150))]
    found = in_parts(program, dict.fromkeys(range(-1, 152), 1))
    assert found == [
        Instruction(Part(x.result, 0), x.op, tuple(Part(a, 0) for a in x.args))
        for x in program
    ]


def test_no_instructions_have_no_parts():
    assert in_parts([], {}) == []
