"""Filtered signals and rows against SciPy, entry by entry. That `r'x = b` holds says less:
it does for any feedthrough, any start and any scale."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from motion import observe
from test_filters import FILTERS

import aslo_jax as aslo
from aslo_jax.filters import Integrator
from aslo_jax.observers import AbstractObserver

A, B, C, D = (np.asarray(getattr(FILTERS["general"], name)) for name in "ABCD")
TS = np.array([0.05, 0.4, 1.1, 2.3])


def integrated(rate, start):
    """The solution of an equation from t = 0 at `TS`, states last."""
    found = scipy.integrate.solve_ivp(
        rate, (0, TS[-1]), start, "DOP853", TS, rtol=1e-13, atol=1e-16
    )
    return found.y.T


def signal(t):
    return 1.4 + np.sin(1.7 * t) + 0.3 * t


class Filtered(AbstractObserver):
    """F[s] and F[1]."""

    filter: aslo.AbstractFilter

    def equations(self, F, u, y):
        F = F.using(self.filter)
        return jnp.stack([F(u, "s"), F.one("one")])


def test_a_filter_with_feedthrough_has_its_transfer_function():
    s = 0.7j + 0.2
    X = np.linalg.solve(s * np.eye(2) - A, B)
    filter = FILTERS["general"]
    assert complex(filter.output(X) + filter.feedthrough(1.0)) == pytest.approx(C @ X + D)
    np.testing.assert_allclose(filter.feedthrough(jnp.array([2.0, -3.0])), [0.4, -0.6])


def test_filtered_signals_are_those_of_scipy():
    states = integrated(
        lambda t, x: np.concatenate([A @ x[:2] + B * signal(t), A @ x[2:] + B]), np.zeros(4)
    )
    expected = np.stack([states[:, :2] @ C + D * signal(TS), states[:, 2:] @ C + D], 1)
    got = observe(
        Filtered(FILTERS["general"]),
        lambda t: 1.4 + jnp.sin(1.7 * t) + 0.3 * t,
        lambda t: jnp.zeros(()),
        jnp.asarray(TS),
        atol=1e-16,
    )
    np.testing.assert_allclose(got, expected, rtol=1e-11)


class Swapped(AbstractObserver):
    """The row that the Swapping Lemma makes of `u`, a row."""

    filter: aslo.AbstractFilter

    def equations(self, F, u, y):
        return aslo.swap(F.using(self.filter), u)


def test_a_swapped_row_is_that_of_scipy():
    """r, b and z that have nothing to do with each other, so that no identity hides a
    term: X' = A X + B r', E' = A E + X z + B b."""
    phase = np.array([0.3, -0.8, 1.9])
    parts = lambda np, t: (
        np.cos(t * phase + 0.2),
        0.8 - np.sin(2.1 * t),
        np.sin(t + phase),
    )

    def rate(t, x):
        r, b, z = parts(np, t)
        X, E = x[:6].reshape(2, 3), x[6:]
        return np.concatenate([(A @ X + np.outer(B, r)).ravel(), A @ E + X @ z + B * b])

    states = integrated(rate, np.zeros(8))
    terms = [parts(np, t) for t in TS]
    r = [C @ x[:6].reshape(2, 3) + D * p[0] for x, p in zip(states, terms, strict=True)]
    b = [C @ x[6:] + D * p[1] for x, p in zip(states, terms, strict=True)]

    def row(t):
        r, b, z = parts(jnp, t)
        return aslo.Row(r, b, z, None, jnp.ones(3))

    got = observe(
        Swapped(FILTERS["general"]),
        row,
        lambda t: jnp.zeros(()),
        jnp.asarray(TS),
        atol=1e-16,
    )
    np.testing.assert_allclose(got.r, r, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(got.b, b, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("v", [0.2, 0.4, 0.47, 0.4999999])
def test_hold_weights_have_all_digits_where_their_series_ends(v):
    """Below v = 1/2 they are a series, here against the closed form in long double, which
    loses one digit of nineteen."""
    got = aslo.LowPass(1.0).discretise(v)
    v = np.longdouble(v)
    p = -np.expm1(-v) / v
    np.testing.assert_allclose(got.left, float(p - np.exp(-v)), rtol=5e-15)
    np.testing.assert_allclose(got.right, float(1 - p), rtol=5e-15)


@pytest.mark.slow
def test_the_paper_start_of_least_squares_with_a_state_matrix():
    """r and M have settled, by a linear system and a Lyapunov equation; v and b start at
    zero, by SciPy."""
    lam, c = 2.7, np.array([1.0, -0.6])
    state = np.array([[0.1, 0.9], [-0.7, -0.3]])
    z = lambda np, t: np.stack([0.3 * np.cos(t), 0.2 + 0.1 * t])
    s = lambda np, t: np.sin(1.3 * t) + 0.4
    r = np.linalg.solve((lam * np.eye(2) + state).T, lam * c)
    half = -0.5 * lam * np.eye(2) - state  # lam M + A'M + M A = lam r r'
    M = scipy.linalg.solve_continuous_lyapunov(half.T, -lam * np.outer(r, r))

    def row(t, x):
        """b, of the filtered s and of the drive."""
        return lam * (s(np, t) - x[0]) + x[1]

    def rate(t, x):
        v = x[2:]
        return np.concatenate(
            [
                [lam * (s(np, t) - x[0]), r @ z(np, t) - lam * x[1]],
                lam * (r * row(t, x) - v) + M @ z(np, t) - state.T @ v,
            ]
        )

    states = integrated(rate, np.zeros(4))
    expected = np.linalg.solve(M, states[:, 2:].T).T

    def relation(u, y):
        return aslo.Rate(jnp.asarray(c), y, u, A=jnp.asarray(state), constant=True)

    observer = aslo.AlgebraicObserver(
        relation, aslo.LowPass(lam), guard=None, start="paper"
    )
    signals = lambda t: z(jnp, t), lambda t: s(jnp, t)
    got = observe(observer, *signals, jnp.asarray(TS), atol=1e-16)
    np.testing.assert_allclose(got.value, expected, rtol=1e-10)


@pytest.mark.parametrize(
    "completion",
    [
        pytest.param(aslo.Repeat(), marks=pytest.mark.slow),
        pytest.param(aslo.FilterBank([aslo.LowPass(4.0)]), marks=pytest.mark.slow),
        aslo.LeastSquares(),
    ],
    ids=["repeat", "bank", "least squares"],
)
def test_neither_estimate_nor_certificate_depends_on_units(completion):
    """One entry in thousandths of its unit, the other in millions: the same certificate,
    which without a scale would be smaller by the square of their ratio."""
    units = np.array([1e3, 1e-6])

    def estimate(units):
        def relation(u, y):
            c = jnp.stack([1.0 + 0.2 * jnp.cos(u), jnp.sin(2.0 * u)])
            z = jnp.stack([jnp.cos(u), -0.5 * jnp.sin(u)])
            return aslo.Linear(c / units, y, z * units)

        observer = aslo.AlgebraicObserver(relation, aslo.LowPass(3.0), completion)
        y = lambda t: (
            (1.0 + 0.2 * jnp.cos(t)) * jnp.sin(t)
            + jnp.sin(2.0 * t) * 0.5 * (jnp.cos(t) - 1.0)
        )
        return observe(observer, lambda t: t, y, jnp.asarray(TS), atol=1e-18)

    plain, scaled = estimate(np.ones(2)), estimate(units)
    truth = np.stack([np.sin(TS), 0.5 * (np.cos(TS) - 1.0)], axis=1)
    np.testing.assert_allclose(plain.value, truth, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(scaled.value / units, plain.value, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(scaled.certificate, plain.certificate, rtol=1e-6)
    assert (plain.certificate > 1e-8).all()


class Completed(AbstractObserver):
    """The certificate of a completion, and the rows that it is of."""

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(2.0))
        second = aslo.swap(F.scope("mine"), u)
        return jnp.stack([u.r, second.r]), aslo.Repeat()(F, u)[1]


def test_rows_are_measured_against_the_terms_that_they_are_the_difference_of():
    """Rows of a thousandth of these are certified by a millionth of what they would be."""
    size = np.array([3.0, 0.02])

    def row(t):
        r = 1e-3 * size * jnp.stack([jnp.cos(t), jnp.sin(2.0 * t)])
        return aslo.Row(r, jnp.zeros(()), jnp.zeros(2), None, jnp.asarray(size))

    rows, certificate = observe(Completed(), row, lambda t: jnp.zeros(()), jnp.asarray(TS))
    for R, found in zip(np.asarray(rows), certificate, strict=True):
        unit = R / (np.abs(R).max(axis=0) + size)
        expected = 2 / np.trace(np.linalg.inv(unit.T @ unit / 2))
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        assert found < 1e-5


def test_an_integrator_keeps_the_precision_of_its_state():
    """Where time is double and the state single."""
    X, v0, v1 = (jnp.asarray(x, jnp.float32) for x in (1.0, 2.0, 4.0))
    h = Integrator().discretise(jnp.asarray(0.25, jnp.float64))
    after = jax.jit(Integrator().advance)(X, v0, v1, h)
    assert after.dtype == jnp.float32
    assert math.isclose(after, 1.75)
