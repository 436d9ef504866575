"""The plan of a step: what waits in registers, and what in memory."""

import hypothesis.strategies as st
import numpy as np
from hypothesis import given, settings

from aslo_jax.engines.graph import Graph
from aslo_jax.engines.registers import Instruction, planned, selected


@st.composite
def programs(draw):
    """Instructions on the nodes from 100 on, of what came before and of two givens, and
    what of it is stored anyway."""
    count = draw(st.integers(1, 14))
    found = []
    for k in range(count):
        before = [0, 1, *range(100, 100 + k)]
        args = draw(st.lists(st.sampled_from(before), min_size=1, max_size=3))
        found.append(Instruction(100 + k, "any", tuple(args)))
    stored = draw(st.sets(st.sampled_from([x.number for x in found])))
    sizes = {x.number: draw(st.sampled_from([1, 2])) for x in found}
    return found, sizes, stored


def checked(instructions, sizes, stored, room):
    """Follows a plan as a processor would, and counts its loads and stores."""
    registers, memory, kept = set(), set(), set()
    done, count = [], 0
    uses = {n: [t for t, x in enumerate(instructions) if n in x.args] for n in sizes}
    for event in planned(instructions, sizes, stored, room):
        number = event.number
        if event.action in ("load", "do"):  # what was over the room has gone
            registers &= kept
        if event.action == "load":
            assert number in memory and number not in registers
            registers.add(number)
            kept.add(number)
        elif event.action == "store":
            assert number in registers and number not in memory
            memory.add(number)
        elif event.action == "free":
            assert number in memory and number not in stored
            memory.remove(number)
            assert not [t for t in uses[number] if t >= len(done)]
        else:
            # What waits beside the arguments of an instruction is within the room.
            waits = {n for n in registers if [t for t in uses[n] if t >= len(done)]}
            beside = waits - set(event.instruction.args)
            assert sum(sizes[n] for n in beside) <= room
            for a in event.instruction.args:
                assert a in registers or a not in sizes
            registers.add(number)
            done.append(event.instruction)
            kept = _soonest(instructions, sizes, registers, len(done), room)
            if number in stored:
                memory.add(number)
        if event.action in ("load", "store"):
            count += 1
    assert done == instructions
    return count


def _soonest(instructions, sizes, registers, time, room):
    """Of what is in registers after so many instructions, what stays: the ones that are
    needed soonest."""
    later = lambda n: next(
        (t for t in range(time, len(instructions)) if n in instructions[t].args), None
    )
    alive = [n for n in registers if later(n) is not None]
    alive.sort(key=lambda n: (later(n), n))
    while sum(sizes[n] for n in alive) > room:
        alive.pop()
    return set(alive)


@settings(max_examples=300)
@given(programs(), st.integers(2, 8))
def test_a_plan_keeps_every_value_that_is_needed(program, room):
    checked(*program, room)


def test_without_want_of_room_nothing_is_loaded_or_stored():
    chain = [Instruction(100 + k, "any", (100 + k - 1, 0)) for k in range(20)]
    sizes = {x.number: 1 for x in chain}
    assert checked(chain, sizes, set(), 2) == 0


def test_the_value_that_is_needed_last_goes():
    """Of three values, with room for two, the first is needed last: it is stored and loaded
    once, and the others never."""
    program = [
        *(Instruction(n, "any", ()) for n in (100, 101, 102)),
        Instruction(103, "any", (101, 102)),
        Instruction(104, "any", (100, 103)),
    ]
    events = [
        (e.action, e.number)
        for e in planned(program, dict.fromkeys(range(100, 105), 1), set(), 2)
    ]
    assert events == [
        ("do", 100),
        ("do", 101),
        ("do", 102),
        ("store", 100),
        ("do", 103),
        ("load", 100),
        ("do", 104),
        ("free", 100),
    ]


def test_products_are_a_part_of_the_sum_that_alone_needs_them():
    graph = Graph()
    a, b, c = (graph.input(np.float64, ("lane", k)) for k in range(3))
    product, shared = graph.op("mul", a, b), graph.op("mul", b, c)
    total = graph.op("add", product, c)
    less = graph.op("sub", a, graph.op("mul", a, c))
    more = graph.op("sub", graph.op("mul", c, c), total)
    both = graph.op("add", shared, graph.op("sub", shared, a))
    numbers = graph.reachable([total, less, more, both])
    found = {x.number: (x.op, x.args) for x in selected(graph, numbers, {less, more, both})}
    assert found[total] == ("muladd", (a, b, c))
    assert found[less] == ("submul", (a, c, a))
    assert found[more] == ("mulsub", (c, c, total))
    assert found[shared][0] == "mul" and found[both][0] == "add"
    assert product not in found
    # A product that is a result, or that two need, is made by itself.
    kept = {x.number: x.op for x in selected(graph, numbers, {product, less, more, both})}
    assert kept[product] == "mul" and kept[total] == "add"
