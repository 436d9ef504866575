"""Factors that do not change over time: fewer products in a step, and the same results."""

import jax.numpy as jnp
import numpy as np
import pytest
from loops import PAIRS, X, check, operations, program, total

pytest.importorskip("llvmlite")


def test_factors_of_a_chain_of_products_are_one_product():
    """R (c (f - m s)) for each lane: R c is known before the loop, and so is m."""

    def advance(k, carry, x):
        f, s = carry
        return 0.9 * f - x[0] * (x[1] * (f - 0.3 * s)), jnp.sin(f) * 0.2 + s

    def by_one(k, carry, x):
        f, s = carry
        return 0.9 * f - x[0] * (f - 0.3 * s), jnp.sin(f) * 0.2 + s

    begin, finish = lambda x: (x[0], x[1]), lambda carry: carry[0] - carry[1]
    made = check(begin, advance, finish, x=PAIRS)
    assert total(made) == total(program(begin, by_one, finish, x=PAIRS))


def test_a_factor_of_each_lane_is_taken_out_of_a_sum():
    """L (a b) - L (c d)."""

    def advance(k, carry, x):
        a, b, c, d = carry
        less = x[0] * (a * b) - x[0] * (c * d)
        return jnp.cos(less), b + x[1], jnp.sqrt(1.0 + d * d), jnp.abs(c + x[1])

    def by_hand(k, carry, x):
        a, b, c, d = carry
        less = x[0] * (a * b - c * d)
        return jnp.cos(less), b + x[1], jnp.sqrt(1.0 + d * d), jnp.abs(c + x[1])

    begin = lambda x: (x[0], x[1], x[0] - x[1], x[0] * x[1])
    finish = lambda carry: carry[0] - carry[1] + carry[2] * carry[3]
    made = check(begin, advance, finish, x=PAIRS)
    assert total(made) == total(program(begin, by_hand, finish, x=PAIRS))


def friction(scaled):
    """Runge-Kutta's method on J v' = k i - b v - c v |v|, i' = (u - k v) / L, with k, b, c
    and u divided by J beforehand or not."""
    h, inertia, k, b, c, inductance = 0.05, 0.7, 1.3, 0.9, 0.4, 1.9
    if scaled:
        k_v, b, c, inertia = k / inertia, b / inertia, c / inertia, 1.0
    else:
        k_v = k

    def slope(v, i, u):
        torque = k_v * i - (b * v + c * (v * jnp.abs(v)))
        return (torque if scaled else torque / inertia), (u - k * v) / inductance

    def advance(n, carry, x):
        v, i = carry
        v1, i1 = slope(v, i, x)
        v2, i2 = slope(v + 0.5 * h * v1, i + 0.5 * h * i1, x)
        v3, i3 = slope(v + 0.5 * h * v2, i + 0.5 * h * i2, x)
        v4, i4 = slope(v + h * v3, i + h * i3, x)
        v = v + h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        return v, i + h / 6.0 * (i1 + 2.0 * i2 + 2.0 * i3 + i4)

    return advance


def test_slopes_share_the_factor_of_an_inertia():
    begin, finish = lambda x: (x, 0.4 - x), lambda carry: (carry[0], carry[1])
    made = check(begin, friction(False), finish)
    assert total(made) <= total(program(begin, friction(True), finish))
    assert total(made) < operations(made.raw).total()


@pytest.mark.parametrize("first", [lambda x: x, lambda x: 0.0 * x, lambda x: 2.0])
def test_an_angle_is_kept_times_what_the_next_step_multiplies_it_by(first):
    """Its next value feeds sin(5 theta), and the record and the end need theta itself."""

    def advance(scale):
        def made(k, carry, x):
            theta, w = carry
            new = theta + 0.05 * w
            turn = jnp.sin(scale * new) - 0.3 * jnp.cos(scale * theta)
            return new, 0.9 * w + 0.1 * turn

        return made

    begin = lambda x: (first(x), 1.0 - x)
    finish = lambda carry: (carry[0] + 0.2, carry[1])
    record = lambda carry: (carry[0] * 3.0, carry[0], carry[1])
    made = check(begin, advance(5.0), finish, record=record)
    assert total(made) == total(program(begin, advance(1.0), finish))
    graph = made.loop.graph
    numbers = graph.reachable(list(made.loop.carry))
    assert 5.0 not in {graph.value(a) for n in numbers for a in graph.nodes[n].args}


def test_what_is_no_sum_may_be_kept_times_what_it_is_multiplied_by():
    """It is scaled once for two steps."""

    def advance(k, carry, x):
        theta, w = carry
        new = jnp.abs(w) / (2.0 + w)
        turn = jnp.sqrt(5.0 * new) + jnp.sqrt(5.0 * theta)
        return new, 0.5 * w + x * x * turn

    finish = lambda carry: (carry[0] + 0.2, carry[1])
    record = lambda carry: (carry[0] * 3.0, carry[0])
    made = check(lambda x: (x * x, 1.0 - x), advance, finish, record=record)
    graph = made.loop.graph
    numbers = graph.reachable(list(made.loop.carry))
    scaled = [n for n in numbers if 5.0 in map(graph.value, graph.nodes[n].args)]
    assert len(scaled) == 1


@pytest.mark.parametrize("scale", [5.0, -5.0, 1e-70, 0.0])
def test_the_sine_of_a_multiple_of_an_angle(scale):
    """Of the angle of the start of a step, by factors of each sign and size."""

    def advance(k, carry, x):
        theta, w = carry
        w = w - 0.1 * jnp.cos(scale * theta)
        return theta + 0.05 * w, w

    record = lambda carry: (carry[0] * 3.0, carry[1])
    check(
        lambda x: (x, x), advance, lambda carry: (carry[0] + 0.2, -carry[1]), record=record
    )


@pytest.mark.parametrize("factor", [3.0, -3.0, 1e-30, -1e40, 1e-300, 1e300, 0.0])
def test_a_carry_may_have_a_factor_of_any_size(factor):
    """The factor of an entry that is recorded, and that another one is made of."""

    def advance(k, carry, x):
        a, b = carry
        small = a / factor if factor else a
        return factor * (0.2 * b * b + 0.1 * x * x), jnp.cos(b) + 0.2 * small

    check(
        lambda x: (factor * x, x),
        advance,
        lambda carry: (carry[0], carry[0] * 0.5, carry[1]),
        record=lambda carry: (carry[0], jnp.abs(carry[0])),
    )


LANES = (np.array([0.0, 1.7, -2.3, 1e-300, 0.8]), np.array([1.1, 0.0, -0.6, 2.0, -1.4]))


def test_factors_of_lanes_may_be_zero():
    """In a sum, in what is kept, in a choice, with each sign."""

    def advance(k, carry, x):
        a, b = carry
        less = x[0] * jnp.sin(a) - x[0] * (a * b)
        chosen = jnp.where(a > b, x[1] * a, x[1] * b)
        return x[0] * (0.3 * b + jnp.cos(a)), 0.1 * less - 0.2 * chosen + jnp.abs(x[1] * a)

    record = lambda carry: (carry[0], carry[1] - carry[0])
    check(lambda x: (x[0], x[1]), advance, lambda c: (c[0], c[1]), record=record, x=LANES)


@pytest.mark.parametrize(
    "part",
    [
        lambda a, x: jnp.where(x > 0.0, a / jnp.where(x > 0.0, x, 1.0), 0.0),
        lambda a, x: jnp.where(x > 0.0, a / x, 0.0),
        lambda a, x: jnp.where(x > 0.0, a * (1.0 / x), 0.0),
        lambda a, x: jnp.where(x <= 0.0, 0.0, a / x),
        lambda a, x: jnp.where(x > 0.0, a / x, 0.0) * 0.5,
        lambda a, x: jnp.where(x > 0.0, jnp.where(a > 0.1, a / x, 0.0), 0.3 * a),
        lambda a, x: jnp.where(x > 0.0, a / x - 2.0 / x, 0.0),
    ],
)
def test_a_quotient_is_guarded_where_a_divisor_of_a_lane_is_zero(part):
    """The guard holds, although all but the choice is known before the loop."""

    def advance(k, carry, x):
        (a,) = carry
        return (0.4 * a + 0.1 * part(a, x[0]),)

    x = (np.array([0.0, 1.7, -2.3, 0.4]), np.array([1.1, 0.3, -0.6, 2.0]))
    check(lambda x: (x[1],), advance, lambda carry: carry[0], x=x)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_a_product_is_guarded_where_a_factor_of_a_lane_is_no_number(bad):
    def advance(k, carry, x):
        (a,) = carry
        finite = jnp.abs(x[0]) < 1e9
        return (0.4 * a + jnp.where(finite, x[0] * a, 0.0),)

    x = (np.array([bad, 0.7, -0.3]), np.array([1.1, 0.3, -0.6]))
    check(lambda x: (x[1],), advance, lambda carry: carry[0], x=x)


def test_choices_have_the_factor_of_both_values():
    def advance(k, carry, x):
        a, b, c = carry
        same = jnp.where(a > b, 0.7 * (a * b), 0.7 * c)
        zero = jnp.where(b > c, 0.0, 1.3 * a)
        signs = jnp.where(a > c, -0.7 * a, 0.7 * b)
        mixed = jnp.where(a > 0.1, 0.7 * a, 1.9 * c)
        return 0.3 * (same - zero), 0.2 * signs + 0.1 * mixed, 0.5 * (a - b) + 0.1 * x

    check(
        lambda x: (x, 0.5 - x, 2.0 * x * x),
        advance,
        lambda carry: carry[0] - 2.0 * carry[1] + 3.0 * carry[2],
        record=lambda carry: carry,
    )


def test_negative_factors_keep_their_signs():
    """In products, quotients, sums, absolute values, and against what nothing changes."""

    def advance(k, carry, x):
        a, b, c = carry
        left = -0.7 * (a - (-1.9 * (b / -1.3)))
        right = jnp.abs(-0.4 * c) - (-(0.3 * (a * -b)))
        apart = (-2.0 / (3.0 + c * c)) - 1.7 / (-3.0 - jnp.abs(a))
        return 0.3 * left, -0.2 * (right - x), -0.5 * apart - (0.1 - 0.2 * a)

    check(
        lambda x: (-x, -0.5 * x, 2.0 - x),
        advance,
        lambda carry: (-carry[0], carry[1], carry[2]),
        record=lambda carry: (carry[0], -carry[1], carry[2]),
    )


def test_what_does_not_change_is_added_to_a_scaled_sum():
    def advance(k, carry, x):
        a, b = carry
        one = 0.3 * (0.7 * a + x[0]) - 0.3 * (x[1] * x[0])
        two = 0.4 * (1.1 - 2.3 * (b * a)) + x[1] * (a + 1.5)
        return one, 0.2 * (two - x[0]) - 0.2 * jnp.sin(b)

    check(lambda x: (x[0], x[1]), advance, lambda c: (c[0], c[1]), x=PAIRS)


def test_factors_of_short_numbers():
    """Float32, in which a product of two may overflow far sooner."""

    def advance(k, carry, x):
        a, b = carry
        big, small = np.float32(1e11), np.float32(1e-11)
        less = big * (small * a - (small * b) * np.float32(0.3))
        turn = jnp.sin(np.float32(5.0) * b)
        return np.float32(0.4) * (less - x) * np.float32(0.7), b + np.float32(0.1) * turn

    x = X.astype(np.float32)
    check(lambda x: (x, -x), advance, lambda c: (c[0], c[1]), x=x, rtol=3e-6, widths=(8,))


@pytest.mark.parametrize(
    ("dtype", "large", "small", "root"),
    [(np.float32, 1e34, 1e-30, 1e12), (np.float64, 1e300, 1e-290, 1e18)],
)
def test_products_stay_within_range_with_their_factors(dtype, large, small, root):
    """A large product, which is scaled before it meets another one."""

    def advance(k, carry, x):
        a, b = carry
        left = jnp.sqrt(dtype(large) + dtype(0.1 * large) * a)
        right = jnp.sqrt(dtype(large) + dtype(0.2 * large) * b * b)
        other = jnp.sqrt(dtype(root) + dtype(0.3 * root) * a)
        product = (dtype(small) * (left * right)) * (dtype(1e-3) * other)
        product = product * dtype(1e3 / (large * small * root**0.5))
        return dtype(0.3) * b * b, x + dtype(0.2) * (product - b)

    x = X.astype(dtype)
    finish = lambda carry: (carry[0], carry[1])
    rtol = 1e-13 if dtype == np.float64 else 3e-6
    made = check(lambda x: (x * x, x), advance, finish, x=x, rtol=rtol)
    _, final = made({"lane": x}, len(x), 7)
    assert np.isfinite(final).all()


def test_products_with_an_argument_in_common_are_scaled_once():
    """u + h (a b) and v - h (a c): a is scaled before."""

    def advance(k, carry, x):
        u, v, a, b, c = carry
        u, v = u + 0.4 * (a * b), v - 0.4 * (a * c)
        return u, v, jnp.abs(u - x), jnp.abs(v + x), jnp.sqrt(1.0 + a * a)

    begin = lambda x: (x, 0.3 - x, x * x, 1.0 - x, 2.0 * x)
    made = check(begin, advance, lambda carry: (carry[0], carry[1]))
    assert [operations(loop)["mul"] for loop in (made.raw, made.loop)] == [2, 1]


def test_entries_that_are_one_or_scaled_are_recorded_as_they_were():
    """Two entries that are alike, scaled, and read by the record and at the end."""

    def advance(k, carry, x):
        a, b, theta = carry
        turn = jnp.sin(4.0 * theta)
        return 0.3 * (a * turn), 0.3 * (b * turn), theta + 0.3 * (x - a)

    made = check(
        lambda x: (0.3 * x, 0.3 * x, x),
        advance,
        lambda carry: (carry[0] * 2.0, carry[1] + carry[2], carry[2]),
        record=lambda carry: (carry[2], carry[0], carry[1] - carry[2]),
    )
    assert len(made.raw.carry) == 3 and len(made.loop.carry) == 2


def test_factors_of_a_lane_do_not_meet_out_of_range():
    """Three charges over 0.1 pF in float32, where 1/C^3 is infinite."""
    charge = np.array([1e-13, 2e-13, 1e-14], np.float32)
    elastance = np.array([1e13, 1e13, 5e13], np.float32)

    def advance(k, carry, x):
        a, b, c, _ = carry
        product = (x[1] * a) * (x[1] * b) * (x[1] * c)
        return b, c, np.float32(0.5) * a, product

    begin = lambda x: (x[0], 2 * x[0], 3 * x[0], jnp.zeros_like(x[0]))
    check(begin, advance, lambda carry: carry, x=(charge, elastance), rtol=1e-5)
