"""Comparisons of quotients with constants: no divisions, and the same results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import check, count

pytest.importorskip("llvmlite")


BOUNDARIES = np.array(
    [0.0, 1e-300, 1.9, 2.1, 8.0, 1e300, -0.4, -1e-300, np.inf, -np.inf, np.nan]
)


def counted(test):
    """A loop that counts how often a test of a carry holds, which begins with x."""
    return dict(
        begin=lambda x: (x, jnp.zeros_like(x)),
        advance=lambda k, carry, x: (
            0.5 * carry[0],
            carry[1] * 2.0 + jnp.where(test(carry[0]), 1.0, 0.0).astype(x.dtype),
        ),
        finish=lambda carry: carry[1],
    )


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "test",
    [
        lambda a: 2.0 / a > 1.0,
        lambda a: jnp.less(1.0, 2.0 / a),
        lambda a: jnp.where(a > 0.1, 2.0 / a, 0.0) > 1e-4,
        lambda a: jnp.where(a > 0.1, 2.0 / jnp.where(a > 0.1, a, 1.0), 0.0) > 1.0,
        lambda a: jnp.where(a < 3.0, jnp.where(a > 0.1, 2.0 / a, -1.0), 1.0) > 1.0,
        lambda a: jnp.where(a > 0.1, 2.0 / a, jnp.nan) > 1.0,
    ],
)
def test_a_quotient_is_compared_without_division(test, dtype):
    x = (
        BOUNDARIES.astype(dtype)
        if dtype == np.float64
        else np.float32([0, 1.9, 2.1, 8, -1])
    )
    made = check(**counted(test), steps=5, x=x)
    assert [count(loop, "div") for loop in (made.raw, made.loop)] == [1, 0]


@pytest.mark.parametrize(
    "test",
    [
        lambda a: -2.0 / a > 1.0,
        lambda a: 2.0 / a > -1.0,
        lambda a: 2.0 / a > 0.0,
        lambda a: 0.0 / a > 1.0,
        lambda a: -2.0 / a > -1.0,
        lambda a: 2.0 / a < 1.0,
        lambda a: 2.0 / a > jnp.inf,
        lambda a: 2.0 / a > jnp.nan,
        lambda a: jnp.inf / a > 1.0,
        lambda a: 1e300 / a > 1e-300,
        lambda a: 1e-300 / a > 1e300,
        lambda a: jnp.where(a > 0.1, 2.0 / a, 1.5) > 1.0,
        lambda a: jnp.where(a > 0.1, 2.0 / a, a) > 1.0,
        lambda a: (2.0 / a > 1.0) & (2.0 / a < 4.0),
        lambda a: (jnp.where(a > 0.1, 2.0 / a, 0.0) > 1.0) & (2.0 / a < 4.0),
        lambda a: (1.0 + a) / a > 1.0,
        lambda a: 2.0 / a > a,
    ],
)
def test_other_quotients_are_compared_as_they_are(test):
    """Of other signs, with other bounds, or that more than one comparison needs."""
    made = check(**counted(test), steps=5, x=BOUNDARIES)
    assert count(made.loop, "div") == 1 and not count(made.loop, "ge", "b")


@pytest.mark.parametrize("where", ["record", "carry"])
def test_a_quotient_that_is_needed_itself_is_made(where):
    quotient = lambda a: 2.0 / a

    def advance(k, carry, x):
        a, b = carry
        more = 0.1 * quotient(a) if where == "carry" else 0.0
        return 0.5 * a + 0.2, 0.7 * b + more + jnp.where(quotient(a) > 1.0, 0.3, 0.2)

    record = (lambda carry: quotient(carry[0])) if where == "record" else None
    made = check(lambda x: (x, -x), advance, lambda carry: carry[1], record=record)
    assert count(made.loop, "div") == 1 and not count(made.loop, "ge", "b")


@pytest.mark.parametrize("dtype", [np.int64, np.int32, np.uint32])
def test_whole_quotients_are_compared_as_they_are(dtype):
    """10 // 4 is not greater than 2, although 4 is less than 10 / 2."""
    ten, two, one = (np.dtype(dtype).type(n) for n in (10, 2, 1))

    def advance(k, carry, x):
        n, found = carry
        large = jax.lax.div(jnp.asarray(ten), n) > two
        return n + one, found * two + large.astype(dtype)

    x = np.array([1, 2, 3, 4, 5], dtype)
    check(lambda x: (x, x - x), advance, lambda carry: carry, x=x, steps=4)
