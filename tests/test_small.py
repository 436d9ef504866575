"""The straight-line solvers, against LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax._small import solve_definite, solve_rows


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
