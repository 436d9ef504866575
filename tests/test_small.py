"""The straight-line solvers, against LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from aslo_jax._small import exponential_integrals, solve_definite, solve_rows


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_definite(n):
    rng = np.random.default_rng(n)
    R = rng.normal(size=(n + 2, n))
    M, v = R.T @ R, rng.normal(size=n)
    x, certificate = jax.jit(solve_definite)(M, v)
    np.testing.assert_allclose(x, np.linalg.solve(M, v), rtol=1e-10)
    np.testing.assert_allclose(certificate, n / np.trace(np.linalg.inv(M)), rtol=1e-10)
    least = np.linalg.eigvalsh(M).min()
    assert least <= certificate * (1 + 1e-12) <= n * least * (1 + 1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 2), (4, 4), (7, 4)])
def test_rows(shape):
    m, n = shape
    rng = np.random.default_rng(10 * m + n)
    R, b = rng.normal(size=shape), rng.normal(size=m)
    x, certificate = jax.jit(solve_rows)(R, b)
    np.testing.assert_allclose(x, np.linalg.lstsq(R, b)[0], rtol=1e-10)
    expected = n / np.trace(np.linalg.inv(R.T @ R / m))
    np.testing.assert_allclose(certificate, expected, rtol=1e-9)


def test_rows_keep_their_digits_when_ill_conditioned():
    """Cramer's rule and the normal equations lose twice as many."""
    hilbert = 1.0 / (np.arange(4)[:, None] + np.arange(4) + 1.0)
    truth = np.array([1.0, -2.0, 3.0, 0.5])
    x, _ = solve_rows(jnp.asarray(hilbert), jnp.asarray(hilbert @ truth))
    np.testing.assert_allclose(x, truth, rtol=1e-11)


def test_singular_systems_have_no_certificate_and_finite_gradients():
    flat = jnp.array([[1.0, 1.0], [1.0, 1.0]])
    x, certificate = solve_definite(flat, jnp.array([1.0, 2.0]))
    assert certificate == 0 and (x == 0).all()
    x, certificate = solve_rows(jnp.zeros((2, 2)), jnp.ones(2))
    assert certificate == 0 and (x == 0).all()
    for solve in (solve_definite, solve_rows):
        for M in (flat, jnp.zeros((2, 2))):

            def total(M, solve=solve):
                x, certificate = solve(M, jnp.ones(2))
                return jnp.sum(x) + certificate

            assert jnp.isfinite(jax.grad(total)(M)).all()


@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.3, 1.0, 8.0, 200.0])
@pytest.mark.parametrize("k", [1, 3])
def test_exponential_and_its_integrals(k, size):
    """By SciPy's exponential of a matrix of blocks, stable and not normal."""
    A = np.random.default_rng(k).normal(size=(k, k))
    A = size * (A - (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(k))
    block = np.zeros((3 * k, 3 * k))
    block[:k, :k] = A
    block[: 2 * k, k:] = np.eye(2 * k)
    expected = np.hsplit(scipy.linalg.expm(block)[:k], 3)
    for found, value in zip(jax.jit(exponential_integrals)(A), expected, strict=True):
        np.testing.assert_allclose(found, value, rtol=0, atol=2e-13 * abs(value).max())


def test_exponential_of_a_rotation_and_its_derivatives():
    """By hand: `exp [[0, -w], [w, 0]]` turns by w, and so does its derivative, a quarter
    further; at zero the second integral is 1/2 and its slope 1/6."""
    turn = lambda w: exponential_integrals(w * jnp.array([[0.0, -1.0], [1.0, 0.0]]))
    for w in (0.0, 0.7, 1.0, 25.0):
        c, s = np.cos(w), np.sin(w)
        value, slope = jax.jvp(turn, (w,), (1.0,))
        np.testing.assert_allclose(value[0], [[c, -s], [s, c]], atol=1e-14)
        np.testing.assert_allclose(slope[0], [[-s, -c], [c, -s]], atol=1e-14)
        reverse = jax.grad(lambda w: turn(w)[0][1, 0])(w)
        np.testing.assert_allclose(reverse, c, atol=1e-14)
    value, slope = jax.jvp(turn, (0.0,), (1.0,))
    np.testing.assert_allclose(value[2], np.eye(2) / 2, rtol=1e-15)
    np.testing.assert_allclose(slope[2], [[0.0, -1 / 6], [1 / 6, 0.0]], rtol=1e-15)
    np.testing.assert_array_equal(jnp.isnan(turn(1e9)[0]), True)
    single = exponential_integrals(jnp.full((1, 1), -3.0, jnp.float32))
    assert single[0].dtype == jnp.float32
    np.testing.assert_allclose(single[0], np.exp(-3.0), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_what_one_row_tells_is_singular_whatever_the_rounding(dtype):
    """A pivot that is rounding has either sign, and a compiler may make it twice."""
    rng = np.random.default_rng(3)
    r = (rng.standard_normal((500, 2)) * 10.0 ** rng.uniform(-4, 4, (500, 1))).astype(dtype)
    M = jax.vmap(jnp.outer)(r, r) * dtype(0.37)
    x, certificate = jax.jit(jax.vmap(solve_definite))(M, 0.2 * r, r * r)
    assert not np.any(x) and not np.any(certificate)
    rows = jnp.stack([r, dtype(1.3) * r], axis=1)
    x, certificate = jax.jit(jax.vmap(solve_rows))(rows, 0.2 * r)
    assert certificate.max() < 8 * np.finfo(dtype).eps
