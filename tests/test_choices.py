"""Choices whose outcome is known where it shows: fewer of them, and the same results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import check, count, program

pytest.importorskip("llvmlite")


@pytest.mark.parametrize(
    "guarded",
    [
        lambda a, b: jnp.where(a > 0.2, 2.0 / jnp.where(a > 0.2, a, 1.0), 0.0),
        lambda a, b: jnp.where(a > 0.2, 0.0, 2.0 / jnp.where(a > 0.2, 1.0, a + 3.0)),
        lambda a, b: jnp.where(~(a > 0.2), 0.0, 2.0 / jnp.where(a > 0.2, a, 1.0)),
        lambda a, b: jnp.where(
            (a > 0.2) & (b > 0.1), a / jnp.where((a > 0.2) & (b > 0.1), b, 1.0), 0.0
        ),
        lambda a, b: jnp.where((a > 0.2) & (b > 0.1), b / jnp.where(a > 0.2, a, 1.0), 0.0),
        lambda a, b: jnp.where(
            (a > 0.2) | (b > 0.1), 0.0, b / jnp.where(a > 0.2, 1.0, a - 3.0)
        ),
        lambda a, b: jnp.where(
            a > 0.2, jnp.abs(jnp.sqrt(jnp.where(a > 0.2, a, 1.0)) - b) * 0.3, 0.0
        ),
    ],
)
def test_a_guard_within_a_guard_is_dropped(guarded):
    """One choice is left of two."""

    def advance(k, carry, x):
        a, b = carry
        return 0.9 * b + 0.1 * guarded(a, b), 0.3 * x - 0.8 * a

    made = check(lambda x: (x, 0.5 - x), advance, lambda carry: carry[0] - carry[1])
    assert [count(loop, "select") for loop in (made.raw, made.loop)] == [2, 1]


def test_a_condition_that_shows_only_where_another_holds_has_no_guard():
    """The second of two that are joined."""

    def advance(k, carry, x):
        a, b = carry
        large = (a > 0.2) & (1.0 / jnp.where(a > 0.2, a, 1.0) > b)
        small = (a < 0.1) | (jnp.where(a < 0.1, 3.0, a) * b > 0.05)
        return 0.7 * b + jnp.where(large, 0.2, 0.1), jnp.where(small, x - a, a)

    made = check(lambda x: (x, 0.5 - x), advance, lambda carry: carry[0] - carry[1])
    assert [count(loop, "select") for loop in (made.raw, made.loop)] == [4, 2]


@pytest.mark.parametrize("shown", ["sum", "condition", "other", "record", "final"])
def test_a_choice_that_shows_elsewhere_is_kept(shown):
    """In a sum, in what decides, for the other value, in a record, at the end."""

    def chosen(carry):
        return jnp.where(carry[0] > 0.2, carry[0], 1.5 + carry[1])

    def advance(k, carry, x):
        a, b = carry
        safe = chosen(carry)
        part = jnp.where(a > 0.2, 2.0 / safe, safe * 0.3 if shown == "other" else 0.0)
        if shown == "sum":
            part = part + 0.1 * safe
        if shown == "condition":
            part = jnp.where(safe > 0.7, part, 0.25)
        return 0.9 * b + 0.1 * part, 0.3 * x - 0.8 * a

    record = chosen if shown == "record" else None
    finish = chosen if shown == "final" else lambda carry: carry[0] - carry[1]
    made = check(lambda x: (x, 0.5 - x), advance, finish, record=record)
    assert count(made.loop, "select") == count(made.raw, "select") >= 2


def test_whole_numbers_are_guarded_before_they_are_divided():
    """A division of whole numbers by zero would end the process."""

    def advance(k, carry, x):
        a, n = carry
        part = jnp.where(n == 0, 0, jax.lax.div(n + 20, jnp.where(n == 0, 1, n)))
        more = jnp.where(n == 0, 0.0, (20 // jnp.where(n == 0, 2, n)) * 0.5)
        return 0.5 * a + 0.1 * (part + more), (n + 1) % 3

    begin = lambda x: (x, (10.0 * x).astype(jnp.int64) % 3)
    finish = lambda carry: (carry[0], carry[1])
    made = program(begin, advance, finish)
    selects = [count(loop, "select", "i") for loop in (made.raw, made.loop)]
    assert selects[0] == selects[1] >= 2
    check(begin, advance, finish)


def test_reals_are_guarded_before_they_are_an_index_or_a_divisor():
    """Beyond the condition they would be none."""
    table = np.array([0.3, -1.1, 0.7, 2.0, -0.6])

    def advance(k, carry, x):
        a, b = carry
        inside = (a > 0.0) & (a < 4.0)
        whole = jnp.where(inside, a, 0.0).astype(jnp.int64)
        entry = jax.lax.dynamic_index_in_dim(jnp.asarray(table), whole, keepdims=False)
        above = a > 1.0
        divisor = jnp.where(above, a, 1.0).astype(jnp.int64)
        part = jnp.where(above, jax.lax.div(jnp.int64(9), divisor) * 0.1, 0.0)
        return 0.9 * a + jnp.where(inside, entry, 2.5) - part, 0.5 * b + a

    made = program(lambda x: (x, x), advance, lambda carry: carry)
    assert count(made.loop, "select") == count(made.raw, "select")
    check(lambda x: (x, x), advance, lambda carry: carry, steps=9)
