"""The pipeline of passes: loops stay well-formed, any pass can be left out, and damage is
found."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import PAIRS

from aslo_jax._ir.graph import Function, Graph
from aslo_jax._ir.loop import Loop, Switch, Tables
from aslo_jax._ir.node import Node
from aslo_jax._ir.verifier import MalformedError, verify
from aslo_jax.engines._fused.program import Bodies, Program
from aslo_jax.engines._passes import PASSES, optimised

pytest.importorskip("llvmlite")
REAL = jax.ShapeDtypeStruct((), np.float64)
SEVEN = jnp.asarray(0.7)


def slope(x):
    return x * x * x / (1.0 + x * x)


def costly(x):
    for c in np.linspace(0.1, 0.9, 60):
        x = x - 0.01 * c * x * (x - c)
    return x


def advance(k, carry, inputs):
    """Something for every pass."""
    (a, twin, same, value), (x, y) = carry, inputs["lane"]

    def moved(a):
        after = a - 0.1 * slope(a) + 0.01 * y * (x * (value - 0.3 * a))
        return jnp.where(after > 0.2, 2.0 / jnp.where(after > 0.2, after, 1.0), after)

    after, follower = moved(a), moved(twin)
    large = 2.0 / (a * a + 0.1) > 1.0
    value = 0.9 * value + 0.1 * same + jnp.where(large, 0.1, slope(a) + slope(after))
    value = jax.lax.cond(a < 0.1, costly, lambda v: v, value)
    return (after, follower, 0.8 * same + 0.01 * k, value), (value, twin - a)


BODIES = Bodies(
    lambda inputs: ((inputs["lane"][0], inputs["lane"][0] + 0.0, SEVEN, SEVEN), None),
    advance,
    lambda carry, inputs: (carry[0] - carry[1], carry[3]),
)


def made(**choice):
    return Program.of(BODIES, {"lane": (REAL, REAL)}, (4,), **choice)


def results(program):
    return jax.tree.leaves(program({"lane": PAIRS}, 3, 9))


def test_each_pass_can_be_left_out():
    """The results of a loop differ by rounding."""
    names = dict.fromkeys(each.name for each in PASSES)
    plain = results(made(without=tuple(names)))
    for without in ((), *((name,) for name in names)):
        for ours, theirs in zip(results(made(without=without)), plain, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13)


def test_each_pass_has_something_to_do_and_is_seen():
    seen = []
    optimised(made().raw, seen=lambda name, loop: seen.append((name, loop)))
    assert [name for name, _ in seen] == ["given", *(each.name for each in PASSES)]
    pairs = itertools.pairwise(seen)
    changed = {name for (_, a), (name, b) in pairs if a.listing() != b.listing()}
    assert changed == {each.name for each in PASSES}


def test_a_listing_shows_every_node_and_the_carry():
    graph = Graph()
    x = graph.input(np.float64, ("carry", 0))
    half = graph.const(0.5, np.float64)
    product = graph.op("mul", x, half)
    loop = Loop(graph, (half,), (product,), record=(x,), first=(half,), final=(x,))
    assert loop.listing().splitlines() == [
        "  %0 = input carry[0] : float64",
        "  %1 = const 0.5 : float64",
        "  %2 = mul %0, %1 : float64",
        "carry[0] : float64 = %1, then %2",
        "first = %1",
        "record = %0",
        "final = %0",
    ]


F, I, B = np.dtype(np.float64), np.dtype(np.int64), np.dtype(bool)


def damaged():
    """Loops, each with one fault, and what is said of it."""
    graph = Graph()
    lane = graph.input(F, ("lane", 0))
    x = graph.input(F, ("carry", 0))
    whole = graph.input(I, ("step", 0))
    log = graph.input(F, ("log", 0))
    total = graph.op("add", x, lane)
    loop = Loop(graph, (lane,), (total,), final=(x,))
    verify(loop)
    other = lambda **new: dataclasses.replace(loop, **new)

    def with_node(*node):
        graph.nodes.append(Node(*node))
        return other(carry=(len(graph.nodes) - 1,))

    yield with_node("add", F, (x, len(graph.nodes) + 1)), "does not precede"
    graph.nodes[-1] = Node("const", F, (), F.type(0))
    yield with_node("add", F, (x, whole)), "operands of float64 and int64"
    yield with_node("add", F, (x,)), "has 1 operands"
    yield with_node("plus", F, (x, x)), "no operation"
    yield with_node("lt", F, (x, lane)), "gives float64"
    yield with_node("add", I, (x, lane)), "of float64 gives int64"
    yield with_node("select", F, (whole, x, lane)), "chooses by int64"
    yield with_node("sqrt", I, (whole,)), "takes int64"
    yield with_node("and", F, (x, lane)), "takes float64"
    yield with_node("bitcast", np.dtype(np.float32), (x,)), "takes float64"
    yield with_node("table", F, (x,), np.zeros(3)), "takes float64"
    yield with_node("const", F, (), np.float32(1)), "is a float32"
    yield with_node("input", F, (x,), ("lane", 0)), "has arguments"
    yield with_node("input", F, (), ("carry", 1)), "slot 1 of 1"
    yield with_node("input", F, (), ("step", 1)), "slot 1 of 1"
    yield with_node("input", F, (), ("time", 0)), "slot 0 of 0"
    yield with_node("input", F, (), ("weather", 0)), "kind 'weather'"
    yield with_node("convert", np.dtype(np.float32), (x,)), "entry 0 is float64 in begin"
    yield other(begin=()), "begin has 0 entries, carry 1"
    yield other(begin=(x,)), "begin uses"
    yield other(first=(log,), record=(x,)), "first uses"
    yield other(first=(lane,)), "first has 1 entries, record 0"
    yield other(first=(whole,), record=(x,)), "entry 0 is int64 in first"
    yield other(final=(log,)), "final uses"
    narrow = graph.input(np.dtype(np.float32), ("carry", 0))
    yield other(final=(narrow,)), "is float32, and carry 0 is float64"
    timed = graph.op("add", x, graph.input(F, ("time", 0)))
    counts = Tables(Loop(graph, (), (), final=(graph.input(I, ("lane", 0)),)))
    yield other(carry=(timed,), tables=counts), "is float64, and time 0 is int64"
    yield with_node("dot", F, (x, lane, x)), "no row and vector"
    yield with_node("dot", I, (whole, whole)), "of int64 gives int64"
    inner = Graph()
    square = inner.op("mul", *[inner.input(F, ("argument", 1))] * 2)
    yield with_node("call", F, (x,), Function(inner, square)), "with 1 operands"
    yield other(switches=(Switch(x, True),)), "branch %1 is float64"
    broken = Tables(Loop(graph, (), (), final=(log,)))
    yield other(carry=(timed,), tables=broken), "final uses"


def test_each_kind_of_damage_is_found():
    for loop, message in damaged():
        with pytest.raises(MalformedError, match=message):
            verify(loop)
