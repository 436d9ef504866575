"""Sines and cosines of angles that a loop computes."""

import operator

import jax.numpy as jnp
import numpy as np
import pytest
from loops import check, operations
from test_elementary import evaluate

from aslo_jax._frontend.libm.exponential import ULP

pytest.importorskip("llvmlite")

RNG = np.random.default_rng(8)
ANGLES = {
    "small": 10.0 ** RNG.uniform(-30, 0, 5_000) * RNG.choice([-1, 1], 5_000),
    "of a turn": RNG.uniform(-7, 7, 20_000),
    "of many turns": RNG.uniform(-1e5, 1e5, 20_000),
}
FUNCTIONS = {"sin": (jnp.sin, np.sin), "cos": (jnp.cos, np.cos), "tan": (jnp.tan, np.tan)}
MADE = {"sum": operator.add, "difference": operator.sub, "product": operator.mul}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("made", MADE)
def test_the_error_is_that_of_an_angle_rounded_twice(made, name, angles, dtype):
    (ours, reference), compose = FUNCTIONS[name], MADE[made]
    x = ANGLES[angles].astype(dtype)
    y = RNG.uniform(0.5, 2, x.size) if made == "product" else RNG.permutation(x)
    y = y.astype(dtype)
    found = evaluate(lambda x, y: ours(compose(x, y)), x, y)
    exact = compose(x.astype(np.longdouble), y.astype(np.longdouble))
    unit = 2 * np.spacing(np.abs(exact).astype(dtype)).astype(np.longdouble)
    expected, low, high = map(reference, (exact, exact - unit, exact + unit))
    bound = np.maximum(np.abs(low - expected), np.abs(high - expected))
    bound += ULP[name] * np.spacing(np.abs(expected).astype(dtype))
    regular = np.abs(np.cos(exact)) > 2 * unit if name == "tan" else True
    assert np.all((np.abs(found - expected) <= bound) | ~np.asarray(regular))


def test_an_angle_is_carried_in_right_angles():
    """No product reduces it: those of a step are the polynomials' and that of the speed."""

    def advance(k, carry, x):
        angle, speed, total = carry
        after = angle + 0.3 * speed
        return after, 0.9 * speed + x, 0.5 * total + jnp.sin(after) + 2.0

    made = check(lambda x: (x, 2.0 * x, 0.0 * x), advance, lambda carry: carry, steps=40)
    found = operations(made.loop)
    assert found["rint"] == 1 and found["fma"] == 13


def test_angles_without_bounds():
    """As NumPy: no numbers; and what is larger than its own unit in the last place tells
    stays a sine."""
    x = np.array([np.inf, -np.inf, np.nan, 1e15, -1e16, 1e17, 1e300])
    for ours in (jnp.sin, jnp.cos):
        found = evaluate(lambda x: ours(x + x), x)  # noqa: B023
        assert np.isnan(found[:3]).all() and (np.abs(found[3:]) <= 1).all()


JUMPS = {
    "floor": lambda a: jnp.floor(4.0 * a),
    "ceil": lambda a: jnp.ceil(4.0 * a - 1.0),
    "round": lambda a: jnp.round(2.0 * a),
    "whole": lambda a: (4.0 * a).astype(jnp.int32),
    "at least": lambda a: a >= 3.0,
    "equal": lambda a: a == 3.0,
    "chosen": lambda a: jnp.where(a - 3.0 < 0.0, 1.0, 2.0),
}


@pytest.mark.parametrize("jump", JUMPS)
def test_an_angle_that_is_compared_or_rounded_is_carried_itself(jump):
    """By quarters it reaches its bounds exactly, as it would not in other units."""

    def advance(k, carry, x):
        angle, total = carry
        after = angle + 0.25
        return after, 0.5 * total + jnp.sin(after) + 2.0

    x = np.array([0.0, 0.25, 0.5])
    begin, finish = lambda x: (x, 0.0 * x), lambda carry: carry[1]
    check(begin, advance, finish, steps=60, record=lambda c: JUMPS[jump](c[0]), x=x)
