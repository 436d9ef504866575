"""The lifted Kalman filter and its smoother against least squares over whole logs."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from test_lifted import SU, SY, chain

import aslo_jax as aslo


def batch(u, y, h, prior):
    """Least squares over a whole log of the double integrator: x1 and x2 at the start and
    the noise of every input, each row in its standard deviation."""
    count = len(y)
    rows, values = [], []
    g = np.zeros((count, 2, count + 1))
    s = np.zeros((count, 2))
    g[0, 0, 0] = g[0, 1, 1] = 1.0
    for k in range(1, count):
        A, b = np.array([[1.0, h], [0.0, 1.0]]), np.array([h * h / 2, h])
        g[k], s[k] = A @ g[k - 1], A @ s[k - 1] + b * u[k - 1]
        g[k, :, k + 1] -= b * SU
    for k in range(count):
        rows.append(g[k, 0] / SY)
        values.append((y[k] - s[k, 0]) / SY)
    rows.append(np.eye(count + 1)[1] / prior)
    values.append(0.0)
    rows.extend(np.eye(count + 1)[2:])
    values.extend([0.0] * (count - 1))
    S = np.linalg.inv(np.array(rows).T @ np.array(rows))
    best = S @ np.array(rows).T @ np.array(values)
    return g[:, 1] @ best + s[:, 1], np.einsum("ki,ij,kj->k", g[:, 1], S, g[:, 1])


def test_smoothing_equals_least_squares_over_the_whole_log():
    h, count, prior = 0.03, 60, 1.7
    t, u, x = chain(2, [0.2, -0.4], h, count)
    rng = np.random.default_rng(5)
    u, y = u + SU * rng.standard_normal(count), x[:, 0] + SY * rng.standard_normal(count)
    observer = aslo.Lifted(aslo.plants.IntegratorChain(2).relation(), SY, SU, prior=prior)
    found = aslo.smooth(observer, t, u, y)
    expected, variance = batch(u, y, h, prior)
    np.testing.assert_allclose(found.value[:, 0], expected, atol=1e-9)
    np.testing.assert_allclose(found.covariance[:, 0, 0], variance, rtol=1e-9)
    last = aslo.replay(observer, t, u, y)
    np.testing.assert_allclose(found.value[-1], last.value[-1], atol=1e-10)


class Spring(eqx.Module):
    """A mass on a spring, whose momentum the noise of the position enters too."""

    def __call__(self, u, y):
        one = jnp.ones_like(u)
        return aslo.Rate(c=one[None], s=y, z=(u - 30.0 * y)[None])


def constrained(rows, values, found):
    """Numbers `g w + s`, each `(g, s)` one of `found`, and their variances, of independent
    unit deviations w for which `rows w = values` exactly."""
    A = np.array(rows)
    K = A.T @ np.linalg.inv(A @ A.T)
    best, S = K @ np.array(values), np.eye(A.shape[1]) - K @ A
    return (
        np.array([g @ best + s for g, s in found]),
        np.array([g @ S @ g for g, _ in found]),
    )


def check_smoothing(relation, expected_of):
    """Smoothing a log of noise gives what `expected_of` it gives."""
    h, count, prior = 0.03, 50, 1.7
    rng = np.random.default_rng(6)
    u, y = rng.standard_normal(count), 0.1 * rng.standard_normal(count)
    observer = aslo.Lifted(relation, SY, SU, prior=prior)
    found = aslo.smooth(observer, h * np.arange(count), u, y)
    expected, variance = expected_of(u, y, h, prior)
    np.testing.assert_allclose(found.value[:, 0], expected, atol=1e-9)
    # `1 - K A` cancels all but a thousandth of the prior's variance.
    np.testing.assert_allclose(found.covariance[:, 0, 0], variance, rtol=1e-7)


def spring_batch(u, y, h, prior):
    """As `batch` for the spring: sigma and x at the start, then for every sample the noise
    of u before it and that of y at it, which is in x, in sigma and in the value."""
    count, size = len(y), 2 * len(y)
    one = np.eye(size)
    sigma, x = (SY * one[0], y[0]), (prior * one[1], 0.0)
    rows, values, found = [], [], [x]
    for k in range(1, count):
        w, n = one[2 * k], one[2 * k + 1]
        z0, z1 = u[k - 1] - 30.0 * y[k - 1], u[k - 1] - 30.0 * y[k]
        noise, shift = -h * SU * w + 30.0 * h * SY * n, 0.5 * h * (z0 + z1)
        moved = 0.5 * h * shift + h * h / 12 * (z0 - z1)
        sigma = (sigma[0] + h * x[0] + 0.5 * h * noise, sigma[1] + h * x[1] + moved)
        x = (x[0] + noise, x[1] + shift)
        found.append(x)
        # The value has no noise but n: an exact constraint.
        rows.append(sigma[0] + SY * n)
        values.append(y[k] - sigma[1])
    return constrained(rows, values, found)


def test_smoothing_knows_that_the_noise_of_y_is_in_the_state():
    check_smoothing(Spring(), spring_batch)


class Fed(eqx.Module):
    """A rate that the noise of the input enters itself, and by that of x; as a row of
    several."""

    def __call__(self, u, y):
        one = jnp.ones((1, 1))
        d = 1.5 * u - 3.0 * y
        return aslo.Rows(C=one, d=d[None], s=y[None], z=2.0 * u[None])


def fed_batch(u, y, h, prior):
    """As `spring_batch`: the noise of u is in x and in sigma, that of y in sigma, too."""
    count, size = len(y), 2 * len(y)
    one = np.eye(size)
    sigma, x = (SY * one[0], y[0]), (prior * one[1], 0.0)
    rows, values, found = [], [], [x]
    for k in range(1, count):
        w, n = one[2 * k], one[2 * k + 1]
        noise, shift = -2.0 * h * SU * w, 2.0 * h * u[k - 1]
        own = h * (1.5 * SU * w - 3.0 * SY * n) + 0.5 * h * noise
        d = 0.5 * h * (3.0 * u[k - 1] - 3.0 * y[k - 1] - 3.0 * y[k])
        sigma = (sigma[0] + h * x[0] + own, sigma[1] + h * x[1] + 0.5 * h * shift - d)
        x = (x[0] + noise, x[1] + shift)
        found.append(x)
        rows.append(sigma[0] + SY * n)
        values.append(y[k] - sigma[1])
    return constrained(rows, values, found)


def test_the_noise_of_an_input_enters_a_rate():
    check_smoothing(Fed(), fed_batch)
