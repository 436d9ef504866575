"""The elementary functions of the fused engine, over their ranges and at their edges."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

from aslo_jax._frontend.libm.exponential import ULP
from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
N = 20_000
RNG = np.random.default_rng(5)
EDGES = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 0.5, -0.5]


def spread(low, high, count=N):
    """Both signs, every order of magnitude from 10^low to 10^high."""
    return 10.0 ** RNG.uniform(low, high, count) * RNG.choice([-1, 1], count)


def uniform(low, high):
    return RNG.uniform(low, high, N)


def quantile(x):
    return scipy.special.erfinv(x.astype(float)).astype(np.longdouble)


def one_by_one(function):
    return lambda x: np.array([function(v) for v in x.tolist()], np.longdouble)


# Function, reference in extended precision, arguments.
CASES = {
    "sin": (jnp.sin, np.sin, [uniform(-1e5, 1e5), uniform(-4, 4), EDGES[:2]]),
    "cos": (jnp.cos, np.cos, [uniform(-1e5, 1e5), uniform(-4, 4), EDGES[:2]]),
    "tan": (jnp.tan, np.tan, [uniform(-1e5, 1e5), uniform(-4, 4), EDGES[:2]]),
    "asin": (jnp.arcsin, np.arcsin, [uniform(-1, 1), spread(-30, -1), EDGES]),
    "acos": (jnp.arccos, np.arccos, [uniform(-1, 1), EDGES]),
    "atan": (jnp.arctan, np.arctan, [spread(-30, 30), uniform(-3, 3), EDGES]),
    "exp": (jnp.exp, np.exp, [uniform(-87, 88), uniform(-1, 1), EDGES]),
    "exp2": (jnp.exp2, np.exp2, [uniform(-125, 127), uniform(-1, 1), EDGES]),
    "expm1": (jnp.expm1, np.expm1, [uniform(-87, 88), spread(-30, 0), EDGES]),
    "log": (jnp.log, np.log, [np.abs(spread(-37, 37)), uniform(0.5, 2), EDGES]),
    "log1p": (jnp.log1p, np.log1p, [np.abs(spread(-30, 30)), uniform(-1, 2), EDGES]),
    "log2": (jnp.log2, np.log2, [np.abs(spread(-37, 37)), uniform(0.5, 2), EDGES]),
    "tanh": (jnp.tanh, np.tanh, [uniform(-30, 30), spread(-30, 1), EDGES]),
    "sinh": (jnp.sinh, np.sinh, [uniform(-87, 87), spread(-30, 1), EDGES]),
    "cosh": (jnp.cosh, np.cosh, [uniform(-87, 87), uniform(-2, 2), EDGES]),
    "asinh": (jnp.arcsinh, np.arcsinh, [spread(-30, 37), uniform(-3, 3), EDGES]),
    "acosh": (jnp.arccosh, np.arccosh, [1 + np.abs(spread(-6, 37)), uniform(1, 2), EDGES]),
    "atanh": (jnp.arctanh, np.arctanh, [uniform(-1, 1), spread(-30, -1), EDGES]),
    "cbrt": (jnp.cbrt, np.cbrt, [spread(-37, 37), uniform(-3, 3), EDGES]),
    "erf": (jax.lax.erf, one_by_one(math.erf), [uniform(-6, 6), spread(-30, 0), EDGES]),
    "erfc": (
        jax.lax.erfc,
        one_by_one(math.erfc),
        [uniform(-6, 9), uniform(0.4, 1.1), EDGES],
    ),
    "logistic": (
        jax.nn.sigmoid,
        lambda x: 1 / (1 + np.exp(-x)),
        [uniform(-80, 80), uniform(-2, 2)],
    ),
    "erf_inv": (jax.lax.erf_inv, quantile, [uniform(-1, 1), 1 - np.abs(spread(-6, 0))]),
}
PAIRS = {
    "atan2": (
        jnp.arctan2,
        np.arctan2,
        [np.concatenate([spread(-30, 30), EDGES, [np.inf, 0.0, -0.0, 2.0]])] * 2,
    ),
    "pow": (jnp.power, np.power, [np.abs(spread(-3, 3)), uniform(-9, 9)]),
    "rem": (jax.lax.rem, np.fmod, [spread(-3, 16), spread(-1, 3)]),
}


def evaluate(function, *arguments):
    """By the engine, one lane for each entry."""
    kinds = tuple(jax.ShapeDtypeStruct((), x.dtype) for x in arguments)
    bodies = Bodies(
        lambda inputs: ((), None),
        lambda k, carry, inputs: ((), None),
        lambda carry, inputs: function(*inputs["lane"]),
    )
    program = Program.of(bodies, {"lane": kinds}, (32,))
    return program({"lane": arguments}, arguments[0].size, 1)[1]


def errors(found, expected):
    """In units in the last place; zero where both are infinite alike or no numbers, and
    where both are less than the least normal number, which a host may take for zero."""
    right = expected.astype(found.dtype)
    tiny = np.finfo(found.dtype).tiny
    same = (found == right) | (np.isnan(found) & np.isnan(right))
    same |= (np.abs(found) < tiny) & (np.abs(right) < tiny)
    with np.errstate(all="ignore"):
        unit = np.spacing(np.abs(right)).astype(np.longdouble)
        error = np.abs(found.astype(np.longdouble) - expected) / unit
    return np.where(same, 0.0, error)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", [*CASES, *PAIRS])
def test_the_error_is_as_stated(name, dtype):
    if name in CASES:
        function, reference, parts = CASES[name]
        arguments = [np.concatenate([np.asarray(p, dtype) for p in parts])]
    else:
        function, reference, parts = PAIRS[name]
        arguments = [np.asarray(p, dtype) for p in parts]
        if name == "atan2":
            arguments[1] = np.random.default_rng(1).permutation(arguments[1])
    with np.errstate(all="ignore"):
        expected = reference(*(x.astype(np.longdouble) for x in arguments))
    error = errors(evaluate(function, *arguments), expected)
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    assert error[worst] <= ULP[name], [x[worst] for x in arguments]


def test_derivatives_are_those_of_jax():
    """Of all functions: what primitives they are made of depends on the version."""
    x = np.linspace(0.07, 0.93, 32)
    moved = lambda name, f: lambda x: f(x + (name == "acosh"))
    rates = [jax.grad(moved(name, f)) for name, (f, *_) in CASES.items()]
    found = evaluate(lambda x: [rate(x) for rate in rates], x)
    for name, rate, ours in zip(CASES, rates, found, strict=True):
        np.testing.assert_allclose(ours, jax.vmap(rate)(x), rtol=1e-13, err_msg=name)


def test_edges_of_pow():
    x = np.array([-2.0, -2.0, -3.0, 0.0, 0.0, 0.0, np.inf, np.inf, 1.0, np.nan, -8.0, 2.0])
    y = np.array([3.0, 2.0, 0.5, 2.5, 0.0, -1.5, -2.0, 2.0, np.nan, 0.0, 1 / 3, 1100.0])
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(evaluate(jnp.power, x, y), np.power(x, y))


def test_numbers_that_overflow_and_vanish():
    x = np.array([710.0, 800.0, -745.0, -746.0, -800.0, 709.7])
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(evaluate(jnp.exp, x), np.exp(x), rtol=1e-15)
    tiny = np.array([5e-324, 1e-310, 2.3e-308])
    np.testing.assert_allclose(evaluate(jnp.log, tiny), np.log(tiny), rtol=1e-15)


@pytest.mark.parametrize(
    ("function", "reference"),
    [
        (lambda x: x % 3.0, lambda x: x % 3.0),
        (jnp.floor, np.floor),
        (jnp.ceil, np.ceil),
        (jnp.round, np.round),
        (jnp.sign, np.sign),
        (jnp.sqrt, np.sqrt),
        (jnp.square, np.square),
        (jnp.abs, np.abs),
        (lambda x: jnp.maximum(x, 0.25), lambda x: np.maximum(x, 0.25)),
        (lambda x: jnp.minimum(0.25, x), lambda x: np.minimum(0.25, x)),
        (lambda x: jnp.clip(x, -1.0, 2.0), lambda x: np.clip(x, -1.0, 2.0)),
        (jnp.isnan, np.isnan),
        (jnp.isfinite, np.isfinite),
        (lambda x: x**3, lambda x: x**3),
        (
            lambda x: jnp.polyval(
                jnp.array([2.0, 3.0, -4.0, 0.5]), jnp.round(jnp.clip(x, -5, 5))
            ),
            lambda x: np.polyval([2.0, 3.0, -4.0, 0.5], np.round(np.clip(x, -5, 5))),
        ),
        (lambda x: x**-2, lambda x: x**-2.0),
        (lambda x: x.astype(jnp.float32).astype(float), lambda x: x.astype(np.float32)),
    ],
)
def test_what_is_exact(function, reference):
    x = np.concatenate([uniform(-5, 5)[:500], EDGES, [1.5, 2.5, -0.5, -1.5]])
    with np.errstate(all="ignore"):
        expected = np.asarray(reference(x), evaluate(function, x).dtype)
        np.testing.assert_allclose(evaluate(function, x), expected, rtol=4e-16)


def test_whole_numbers():
    i = np.arange(-40, 40, dtype=np.int32)
    u = np.array([0, 1, 5, 0xFFFFFFFF, 0x80000000, 123456789] * 3, np.uint32)
    shift = np.array([0, 1, 31, 32, 40, 7] * 3, np.uint32)
    np.testing.assert_array_equal(evaluate(lambda i: i // 7, i), i // 7)
    np.testing.assert_array_equal(evaluate(lambda i: i % 7, i), i % 7)
    np.testing.assert_array_equal(evaluate(lambda i: ~i ^ 12, i), ~i ^ 12)
    np.testing.assert_array_equal(evaluate(jnp.abs, i), np.abs(i))
    expected = np.where(shift < 32, u << np.minimum(shift, 31), 0)
    np.testing.assert_array_equal(evaluate(jax.lax.shift_left, u, shift), expected)
    expected = np.where(shift < 32, u >> np.minimum(shift, 31), 0)
    np.testing.assert_array_equal(evaluate(jax.lax.shift_right_logical, u, shift), expected)
    np.testing.assert_array_equal(evaluate(lambda u: u.astype(float), u), u.astype(float))
    np.testing.assert_array_equal(evaluate(lambda u: u * u + u, u), u * u + u)
