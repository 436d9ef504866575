"""Sums of two entries of a carry: fewer entries, and the same results."""

import jax.numpy as jnp
import pytest
from loops import check

pytest.importorskip("llvmlite")


@pytest.mark.parametrize(
    "joined",
    [
        lambda a, b, x: a + b,
        lambda a, b, x: a - b,
        lambda a, b, x: 0.7 * b - 1.9 * a,
        lambda a, b, x: x * a + 0.3 * b,
        lambda a, b, x: 0.3 * (x * a) - b,
    ],
)
def test_a_sum_that_alone_needs_two_entries_is_carried(joined):
    def advance(k, carry, x):
        a, b, c = carry
        both = joined(a, b, x)
        return jnp.sin(c), 0.3 * (c * c), jnp.cos(both) + both * c

    made = check(lambda x: (x, 2.0 - x, x * x), advance, lambda carry: carry[2])
    assert [len(loop.carry) for loop in (made.raw, made.loop)] == [3, 2]


def test_sums_of_sums_are_carried():
    def advance(k, carry, x):
        a, b, c, d = carry
        both = (a + b) - (0.3 * c)
        return jnp.sin(d), 0.3 * (d * d), d * x, jnp.cos(both) + 0.1 * both

    made = check(lambda x: (x, 2.0 - x, x * x, 0.5), advance, lambda carry: carry[3])
    assert [len(loop.carry) for loop in (made.raw, made.loop)] == [4, 2]


def test_a_sum_that_the_record_and_the_end_need_is_carried():
    """Of the entries themselves they need nothing."""

    def advance(k, carry, x):
        a, b, c = carry
        both = a + b
        return jnp.sin(c), 0.3 * (c * c), jnp.cos(both) + both * c

    made = check(
        lambda x: (x, 2.0 - x, x * x),
        advance,
        lambda carry: (carry[2], carry[0] + carry[1]),
        record=lambda carry: (carry[0] + carry[1]) * carry[2],
    )
    assert len(made.loop.carry) == 2


@pytest.mark.parametrize(
    "joined", [lambda a, b, k: a * jnp.cos(0.3 * k) + b, lambda a, b, k: a + b * b]
)
def test_a_sum_of_what_changes_otherwise_is_not_carried(joined):
    """A product with what depends on time, and a square."""

    def advance(k, carry, x):
        a, b, c = carry
        return jnp.sin(c), 0.3 * (c * c), jnp.cos(joined(a, b, k)) - 0.1 * c

    made = check(lambda x: (x, 2.0 - x, x * x), advance, lambda carry: carry[2])
    assert len(made.loop.carry) == 3


@pytest.mark.parametrize("who", ["record", "final", "step", "carry", "record alone"])
def test_entries_that_are_needed_themselves_are_carried(who):
    def advance(k, carry, x):
        a, b, c = carry
        both = a + b
        more = 0.2 * jnp.sin(a) if who == "step" else 0.0
        return b if who == "carry" else jnp.sin(c), 0.3 * (c * c), jnp.cos(both) + more

    records = {"record": lambda carry: carry[0] * 3.0, "record alone": lambda c: c[0]}
    record = records.get(who)
    finish = (lambda c: c[2] - 2.0 * c[1]) if who == "final" else (lambda c: c[2])
    begin = lambda x: (x, 2.0 - x, x * x)
    made = check(begin, advance, finish, record=record)
    assert len(made.loop.carry) == 3
