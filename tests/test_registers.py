"""The plan of a step: what waits in registers, and what in memory."""

import collections

import hypothesis.strategies as st
import numpy as np
from hypothesis import given, settings

from aslo_jax._ir.graph import Graph
from aslo_jax._ir.selection import Instruction, selected
from aslo_jax.engines._backend.spilling import planned


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
    stored = draw(st.sets(st.sampled_from([x.result for x in found])))
    return found, stored


def checked(instructions, stored, room):
    """Follows a plan as a processor would, and counts its loads and stores."""
    made = [x.result for x in instructions]
    uses = {a: [] for x in instructions for a in (x.result, *x.args)}
    for time, x in enumerate(instructions):
        for a in set(x.args):
            uses[a].append(time)
    registers, memory = set(), uses.keys() - set(made)
    done, actions = [], collections.Counter()
    later = lambda v: any(t >= len(done) for t in uses[v])
    for action, value, instruction in planned(instructions, stored, room):
        actions[action] += 1
        if action == "load":
            assert value in memory and value not in registers
            registers.add(value)
        elif action == "store":
            assert value in registers and value not in memory
            registers.remove(value)
            memory.add(value)
        elif action == "drop":
            assert value in registers and value in memory
            registers.remove(value)
        elif action == "free":
            assert value in memory and value not in stored and not later(value)
            memory.remove(value)
        else:
            elsewhere = set(instruction.args) - registers
            assert elsewhere.isdisjoint(made), "what is made is read from registers"
            done.append(instruction)
            registers = {v for v in registers if later(v)}
            # All but one of what is read from memory passes through registers.
            more = max(len(elsewhere) - 1, 1 if later(value) else 0)
            assert len(registers) + more <= room
            if later(value):
                registers.add(value)
            if value in stored:
                memory.add(value)
        assert len(registers) <= room
    assert done == instructions
    return actions


@settings(max_examples=300)
@given(programs(), st.integers(4, 8))
def test_a_plan_keeps_every_value_that_is_needed(program, room):
    checked(*program, room)


def test_without_want_of_room_nothing_made_is_loaded_or_stored():
    chain = [Instruction(100 + k, "any", (100 + k - 1, 0)) for k in range(1, 21)]
    actions = checked(chain, set(), 3)
    assert actions == {"do": 20, "load": 1}  # of the given 0, which waits in a register


def test_what_no_instruction_makes_is_read_from_memory_unless_it_is_needed_again_soon():
    """The given 0 is needed twice at once, and the given 1 long after its first use."""
    program = [
        Instruction(100, "any", (0, 1)),
        Instruction(101, "any", (100, 0)),
        *(Instruction(n, "any", (n - 1,)) for n in range(102, 120)),
        Instruction(120, "any", (119, 1)),
    ]
    events = [(e.action, e.value) for e in planned(program, set(), 4)]
    assert events[:3] == [("load", 0), ("do", 100), ("do", 101)]
    assert ("load", 1) not in events


def test_the_value_that_is_needed_last_goes():
    """Of three values, with room for two, the first is needed last: it is stored and loaded
    once, and the others never."""
    program = [
        *(Instruction(n, "any", ()) for n in (100, 101, 102)),
        Instruction(103, "any", (101, 102)),
        Instruction(104, "any", (100, 103)),
    ]
    events = [(e.action, e.value) for e in planned(program, set(), 2)]
    assert events == [
        ("do", 100),
        ("do", 101),
        ("store", 100),
        ("do", 102),
        ("do", 103),
        ("load", 100),
        ("do", 104),
        ("free", 100),
    ]


def test_what_is_in_memory_goes_before_what_must_be_stored():
    """Of three values the one with a place in memory goes, though it is needed sooner."""
    program = [
        *(Instruction(n, "any", ()) for n in (100, 101, 102, 103)),
        Instruction(104, "any", (102, 103)),
        Instruction(105, "any", (100, 104)),
        Instruction(106, "any", (101, 105)),
    ]
    actions = checked(program, {100}, 3)
    assert actions["store"] == 0 and actions["drop"] == 1 and actions["load"] == 1
    assert checked(program, set(), 3)["store"] == 1


def test_products_are_a_part_of_the_sum_that_alone_needs_them():
    graph = Graph()
    a, b, c = (graph.input(np.float64, ("lane", k)) for k in range(3))
    product, shared = graph.op("mul", a, b), graph.op("mul", b, c)
    total = graph.op("add", product, c)
    less = graph.op("sub", a, graph.op("mul", a, c))
    more = graph.op("sub", graph.op("mul", c, c), total)
    both = graph.op("add", shared, graph.op("sub", shared, a))
    numbers = graph.reachable([total, less, more, both])
    found = {x.result: (x.op, x.args) for x in selected(graph, numbers, {less, more, both})}
    assert found[total] == ("muladd", (a, b, c))
    assert found[less] == ("submul", (a, c, a))
    assert found[more] == ("mulsub", (c, c, total))
    assert found[shared][0] == "mul" and found[both][0] == "add"
    assert product not in found
    # A product that is a result, or that two need, is made by itself.
    kept = {x.result: x.op for x in selected(graph, numbers, {product, less, more, both})}
    assert kept[product] == "mul" and kept[total] == "add"
