"""Loops with less to do in a step: the results of a plain loop, by fewer operations."""

import jax.numpy as jnp
import numpy as np
import pytest
from loops import X, by_hand, check, program

from aslo_jax._ir.graph import Graph
from aslo_jax.engines._backend.scheduling import depth_first, ordered

pytest.importorskip("llvmlite")


def test_entries_that_are_always_equal_are_one():
    """Two that only look different, one that begins otherwise, one that never changes."""

    def begin(x):
        return (x, x + 0.0, 2.0 * x, 0.5 * x)

    def advance(k, carry, x):
        a, b, c, d = carry
        return (jnp.sin(b) + d, jnp.sin(a) + d, jnp.sin(c) + d, d)

    made = check(begin, advance, lambda carry: carry[0] + carry[1] * carry[2])
    assert len(made.raw.carry) == 4 and len(made.loop.carry) == 2


def test_entries_that_part_later_are_kept_apart():
    """Alike at the start, and driven by entries that differ."""

    def advance(k, carry, x):
        a, b, c, d = carry
        return (a + c, b + d, 0.9 * c, 0.8 * d)

    made = check(lambda x: (x, x, x, x), advance, lambda c: c[0] - c[1])
    assert len(made.loop.carry) == 4


def test_what_nothing_needs_is_not_carried():
    def advance(k, carry, x):
        a, b = carry
        return (0.5 * a + x, jnp.sin(a) + b)

    made = check(lambda x: (x, x), advance, lambda carry: carry[0])
    assert len(made.loop.carry) == 1


def test_the_end_of_a_step_serves_the_start_of_the_next():
    """Heun's method on x' = -sin(x)^3: the slope at the end is needed again only where the
    next step begins at it, which it does where the step is corrected no more."""

    def slope(x):
        return jnp.sin(x) ** 3

    def advance(k, carry, x):
        old, total = carry
        new = old - 0.1 * slope(old)
        return new, total + slope(old) + slope(new)

    made = check(lambda x: (x, 0.0), advance, lambda carry: carry[1])
    one = program(
        lambda x: (x,), lambda k, c, x: (c[0] - 0.1 * slope(c[0]),), lambda c: c[0]
    )
    assert made.operations <= one.operations + 4


def test_a_quotient_of_a_chosen_value_is_chosen():
    """1/w of a w that a step keeps or renews; the renewed one is divided by anyway."""

    def advance(k, carry, x):
        w, y = carry
        new = 0.9 * w + 0.1
        y = y + x * (1.0 / new) - x * (1.0 / w)
        return jnp.where(y < 0.2, new, w), y

    def plain(k, carry, x):
        w, y = carry
        new = 0.9 * w + 0.1
        y = y + x * (1.0 / new) - x * (1.0 / w)
        return (new if y < 0.2 else w), y

    begin, finish = lambda x: (2.0 + x, x), lambda carry: carry[0] + carry[1]
    made = program(begin, advance, finish)
    _, final = made({"lane": X}, len(X), 9)
    _, expected = by_hand(begin, plain, finish, 9)
    np.testing.assert_allclose(final, expected, rtol=1e-13)
    assert [quotients(loop) for loop in (made.raw, made.loop)] == [2, 1]


def quotients(loop):
    return sum(loop.graph.nodes[n].op == "div" for n in loop.of_a_step())


def test_what_depends_on_time_alone_is_computed_for_all_steps_at_once():
    def advance(k, carry, x):
        return (0.9 * carry[0] + jnp.sin(0.3 * k) * x,)

    made = check(lambda x: (x,), advance, lambda carry: carry[0], steps=23)
    assert made.loop.tables.beside is not None and made.loop.tables.along is None
    assert made.operations == 3


def test_the_order_has_arguments_first():
    graph = Graph()
    x, y = (graph.input(np.float64, ("carry", i)) for i in range(2))
    numbers = [x, y]
    rng = np.random.default_rng(0)
    for op in rng.choice(["mul", "add", "sub", "div"], 200):
        graph.op(op, *(int(n) for n in rng.choice(numbers[-20:], 2)))
        numbers.append(len(graph.nodes) - 1)
    numbers = sorted(set(numbers))
    needed = graph.reachable(numbers[::7])
    every = ordered(graph, numbers)
    deep = depth_first(graph, numbers[::7], set(numbers))
    for found, expected in ((every, numbers), (deep, needed)):
        assert sorted(found) == expected
        place = {n: k for k, n in enumerate(found)}
        assert all(place[a] < place[n] for n in found for a in graph.nodes[n].args)
