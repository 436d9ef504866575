import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import aslo_jax as aslo
from aslo_jax.filters import (
    LinearSystem,
    bias_rejecting,
    second_order,
    sinusoid_rejecting,
)
from aslo_jax.schedules import Schedule

FILTERS = {
    "low pass": aslo.LowPass(3.0),
    "general": aslo.LinearFilter(
        [[-2.0, 1.0], [-3.0, -4.0]], [0.5, 2.0], [1.0, 0.3], jnp.asarray(0.2)
    ),
    "second order": second_order(2.0),
    "bias rejecting": bias_rejecting(2.5),
    "sinusoid rejecting": sinusoid_rejecting(3.0, 5.0),
}


def response(filter, s):
    """F(s), assembled from the filter's own methods."""
    shape = jnp.shape(filter.inject(1.0))
    k = math.prod(shape)
    zero = jnp.zeros(shape)
    basis = jnp.eye(k).reshape(k, *shape)
    A = np.stack([np.ravel(filter.flow(e, zero)) for e in basis], axis=1)
    C = np.array([filter.output(e) for e in basis])
    B = np.ravel(filter.inject(1.0))
    return C @ np.linalg.solve(s * np.eye(k) - A, B) + filter.feedthrough(1.0)


@pytest.mark.parametrize("s", [0.0, 1.3j, -0.4 + 2.0j])
def test_transfer_functions(s):
    lam, w, zeta = 3.0, 5.0, 0.7
    notch = (s**2 + w**2) / (s**2 + 2 * zeta * w * s + w**2)
    expected = {
        "low pass": 3 / (s + 3),
        "second order": 4 / (s**2 + 2**0.5 * 2 * s + 4),
        "bias rejecting": (2 * 2.5 * s + 2.5**2) / (s + 2.5) ** 2,
        "sinusoid rejecting": lam / (s + lam) * notch,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(response(FILTERS[name], s), value, rtol=1e-13)


def test_internal_model_has_a_zero_at_its_frequency():
    assert abs(response(FILTERS["sinusoid rejecting"], 5.0j)) < 1e-15
    assert abs(response(FILTERS["sinusoid rejecting"], 4.0j)) > 0.05


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("h", [1e-6, 1e-2, 0.7])
def test_sampled_advance_is_exact_under_first_order_hold(name, h):
    filter = FILTERS[name]
    shape = jnp.shape(filter.inject(1.0))
    rng = np.random.default_rng(1)
    X, v0, v1 = rng.normal(size=(3, *shape))

    def rate(t, x):
        v = v0 + (v1 - v0) * t / h
        return np.ravel(filter.flow(jnp.asarray(x.reshape(shape)), jnp.asarray(v)))

    reference = scipy.integrate.solve_ivp(
        rate, (0, h), np.ravel(X), method="DOP853", rtol=1e-13, atol=1e-15
    ).y[:, -1]
    got = filter.advance(X, v0, v1, filter.discretise(h))
    np.testing.assert_allclose(np.ravel(got), reference, rtol=2e-12, atol=1e-14)


def test_advance_keeps_the_shape_of_the_signal():
    filter = FILTERS["general"]
    s0, s1 = np.random.default_rng(2).normal(size=(2, 3, 4))
    v0, v1 = filter.inject(s0), filter.inject(s1)
    whole = filter.advance(jnp.zeros((2, 3, 4)), v0, v1, filter.discretise(0.1))
    one = filter.advance(jnp.zeros(2), v0[:, 2, 1], v1[:, 2, 1], filter.discretise(0.1))
    np.testing.assert_allclose(whole[:, 2, 1], one, rtol=1e-14)


def test_low_pass_equals_the_linear_filter_of_order_one():
    low_pass, linear = aslo.LowPass(4.0), aslo.LinearFilter([[-4.0]], [4.0], [1.0])
    scalar, matrix = low_pass.discretise(0.13), linear.discretise(0.13)
    for a, b in zip(jax.tree.leaves(scalar), jax.tree.leaves(matrix.hold), strict=True):
        np.testing.assert_allclose(a, np.squeeze(b), rtol=1e-14)
    np.testing.assert_allclose(matrix.slowest, scalar.decay, rtol=1e-8)
    np.testing.assert_allclose(matrix.whole, scalar.decay, rtol=1e-8)


@pytest.mark.parametrize("h", [1e-6, 1e-3, 0.5])
def test_a_filter_knows_what_it_remembers(h):
    """The eigenvalues of NumPy, of a matrix that rings, one that is defective, and one that
    is far from normal: the slowest, or the sum of all time constants."""
    matrices = (
        [[-1.0, 50.0], [-70.0, -2.0]],
        [[-3.0, 0.0, 0.0], [3.0, -3.0, 0.0], [0.0, 3.0, -3.0]],
        [[-40.0, 900.0], [0.0, -5.0]],
    )
    for A in matrices:
        poles = np.linalg.eigvals(np.array(A))
        slowest = -poles.real.max()
        together = min(slowest, 1.0 / np.sum(-1.0 / poles).real)
        filter = aslo.LinearFilter(A, np.ones(len(A)), np.ones(len(A)))
        found = filter.discretise(h)
        np.testing.assert_allclose(-np.log(found.slowest) / h, slowest, rtol=0.02)
        np.testing.assert_allclose(-np.log(found.whole) / h, together, rtol=0.02)
    assert together < 0.9 * slowest


@pytest.mark.parametrize("v", [1e-8, 1e-4, 1e-3, 0.03, 0.499999, 0.5, 2.0, 40.0, 1e6])
def test_hold_weights_are_accurate_and_positive_in_single_precision(v):
    # The textbook form 1 - (1 - exp(-v))/v is wrong by 1e-4 at v = 1e-3 in float32.
    rate = jnp.asarray(1.0, jnp.float32)
    got = aslo.LowPass(rate).discretise(jnp.asarray(v, jnp.float32))
    v = np.longdouble(np.float32(v))
    if v < 0.1:
        series = [(-v) ** k / math.factorial(k + 2) for k in range(12)]
        right = v * sum(series)
        left = v * (1 - v * sum(series)) - right
    else:
        p = -np.expm1(-v) / v
        left, right = p - np.exp(-v), 1 - p
    assert got.left.dtype == jnp.float32
    assert got.left > 0 and got.right > 0
    np.testing.assert_allclose(got.left, float(left), rtol=3e-6)
    np.testing.assert_allclose(got.right, float(right), rtol=1e-6)


def test_a_slow_filter_of_any_order_keeps_its_digits_in_single_precision():
    """Two seconds at 20 kHz beside the exponential, in the precision that JAX has by
    default. Rounding moves each of N steps by up to 6e-8, together by a root of N of them;
    a decay that is rounded before 1 is taken from it would be off by some 3e-4."""
    A, B, begun = [[-0.9, 0.4], [-0.3, -0.7]], [1.0, -0.5], np.array([0.8, -0.6])
    h, steps = 5e-5, 40_000
    with jax.enable_x64(False):
        filter = aslo.LinearFilter(A, B, [1.0, 0.0])
        hold, v = filter.discretise(h), filter.inject(1.0)
        step = lambda k, X: filter.advance(X, v, v, hold)
        found = jax.lax.fori_loop(0, steps, step, jnp.asarray(begun))
    assert found.dtype == jnp.float32
    settled = -np.linalg.solve(A, B)
    expected = settled + scipy.linalg.expm(steps * h * np.array(A)) @ (begun - settled)
    np.testing.assert_allclose(found, expected, rtol=0, atol=6e-8 * steps**0.5)


def test_hold_weights_are_differentiable_in_the_rate():
    def weights(rate, h):
        return jnp.stack(jax.tree.leaves(aslo.LowPass(rate).discretise(h)))

    for rate in (1e-3, 3.0, 30.0):
        got = jax.jacfwd(weights)(rate, 0.1)
        d = 1e-6 * rate
        central = (weights(rate + d, 0.1) - weights(rate - d, 0.1)) / (2 * d)
        np.testing.assert_allclose(got, central, rtol=1e-6, atol=1e-9)


def test_equilibrium_is_where_a_constant_has_settled():
    for filter in FILTERS.values():
        X = filter.equilibrium(jnp.array([2.0, -3.0]))
        v = filter.inject(jnp.array([2.0, -3.0]))
        np.testing.assert_allclose(filter.flow(X, v), 0, atol=1e-14)
        gain = response(filter, 0.0) - filter.feedthrough(1.0)
        np.testing.assert_allclose(
            filter.output(X), gain * np.array([2.0, -3.0]), rtol=1e-13
        )


def test_linear_system_matches_expm():
    A = np.array([[0.0, 1.0], [-2.0, -3.0]])
    coefficients = LinearSystem(A).discretise(0.4)
    np.testing.assert_allclose(coefficients[0], scipy.linalg.expm(0.4 * A), rtol=1e-13)
    phi1 = np.linalg.solve(0.4 * A, scipy.linalg.expm(0.4 * A) - np.eye(2))
    np.testing.assert_allclose(coefficients[1] + coefficients[2], 0.4 * phi1, rtol=1e-12)


def test_arguments_are_refused_with_the_remedy():
    with pytest.raises(ValueError, match=r"`rate` must be positive and finite \(rad/s\)"):
        aslo.LowPass(0.0)
    with pytest.raises(ValueError, match=r"but got -2\.0"):
        aslo.LowPass(-2.0)
    with pytest.raises(ValueError, match="`rate` must be positive and finite"):
        aslo.LowPass(float("nan"))
    with pytest.raises(ValueError, match=r"stable matrix .* largest real part is 0\.5"):
        aslo.LinearFilter([[0.5]], [1.0], [1.0])
    expected = r"shapes \(k, k\), \(k,\) and \(k,\), but got \(2, 2\), \(1,\) and \(2,\)\."
    with pytest.raises(ValueError, match=expected):
        aslo.LinearFilter([[-1.0, 0.0], [0.0, -2.0]], [1.0], [1.0, 1.0])
    for A in (-2.0, [-2.0, -1.0], [[[-2.0]]]):
        with pytest.raises(ValueError, match="`A` must be a matrix, but got an array of"):
            aslo.LinearFilter(A, [1.0], [1.0])
    with pytest.raises(ValueError, match="`frequency` must be positive"):
        sinusoid_rejecting(1.0, -1.0)


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_is_linear_in_its_signal(name):
    filter, s = FILTERS[name], jnp.array([-2.5, 0.0, 0.7])
    np.testing.assert_allclose(filter.feedthrough(s), s * filter.feedthrough(1.0))
    np.testing.assert_allclose(filter.inject(s), jnp.multiply.outer(filter.inject(1.0), s))


def test_the_slowest_rate_of_a_filter_is_its_own_or_the_least_of_its_schedule():
    schedule = Schedule(lambda t, u, y: 9.0 + t, low=6.5, high=40.0)
    assert aslo.LowPass(17.0).slowest == 17.0
    assert aslo.LowPass(schedule).slowest == 6.5
