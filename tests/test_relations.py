"""Every row is an identity for all t > 0: tested on signals in closed form, with
asymmetric parameters, against integration at 1e-12."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM, Together, observe_by_scipy as observe
from test_filters import FILTERS

import aslo_jax as aslo
from aslo_jax.observers import AbstractObserver

TS = jnp.array([1e-3, 1e-2, 0.1, 0.5, 1.0, 2.5])
STRICTLY_PROPER = [name for name, f in FILTERS.items() if f.strictly_proper]


class RowObserver(AbstractObserver):
    """Shows a row (or a row swapped again) instead of an estimate."""

    relation: eqx.Module
    filter: aslo.AbstractFilter
    swaps: int = 0
    start: str = "exact"

    def equations(self, F, u, y):
        F = F.using(self.filter, self.start)
        row = self.relation(u, y).row(F.scope("row"))
        for k in range(self.swaps):
            row = aslo.swap(F.scope(f"swap{k}"), row)
        return row


def x3(t):
    """A state of three entries."""
    return jnp.stack([jnp.sin(1.1 * t) + 0.4, jnp.cos(0.7 * t) - t / 5, jnp.exp(-t) + 0.3])


def derivative(f, t):
    return jax.jvp(f, (t,), (jnp.ones_like(t),))[1]


def c3(t):
    return jnp.stack([1.0 + 0.2 * jnp.cos(2.0 * t), jnp.sin(t) - 0.3, 0.5 + 0.0 * t])


def rotation(t):
    """A state matrix that varies and is not symmetric."""
    zero = jnp.zeros_like(t)
    return jnp.stack(
        [
            jnp.stack([zero, 1.0 + 0.3 * jnp.sin(t), zero]),
            jnp.stack([-0.7 + zero, zero, 0.4 * jnp.cos(t)]),
            jnp.stack([zero + 0.2, zero, -0.1 + zero]),
        ]
    )


def rows_of(observer, terms):
    """Rows over time; `terms(t)` are handed to the relation as its input."""
    return observe(observer, terms, lambda t: jnp.zeros(()), TS, atol=1e-16)


@functools.cache
def rows_by_filter(terms, swaps=0, strictly_proper=False):
    names = STRICTLY_PROPER if strictly_proper else FILTERS
    made = {name: RowObserver(FromInput(), FILTERS[name], swaps) for name in names}
    return rows_of(Together(made), terms)


def check(rows, x):
    """`r'x = b`, which is not 0 = 0."""
    error = jnp.sum(rows.r * jax.vmap(x)(TS), -1) - rows.b
    np.testing.assert_allclose(error, 0, atol=1e-11)
    assert np.abs(rows.b[3:]).min() > 1e-3


class FromInput(eqx.Module):
    """A relation whose terms arrive as the input."""

    def __call__(self, u, y):
        del y
        return u


def linear_terms(t):
    x, c = x3(t), c3(t)
    return aslo.Linear(c, jnp.sum(c * x), derivative(x3, t))


def rate_terms(t):
    # s(0) is far from zero and d is not zero: both signs and the start are exposed.
    x, c = x3(t), c3(t)
    s = jnp.cos(0.9 * t) + 1.7
    d = jnp.sum(c * x) + 0.9 * jnp.sin(0.9 * t)
    return aslo.Rate(c, s, derivative(x3, t), d)


def affine_rate_terms(t):
    x, A = x3(t), rotation(t)
    terms = rate_terms(t)
    return aslo.Rate(terms.c, terms.s, derivative(x3, t) - A @ x, terms.d, A)


def affine_linear_terms(t):
    x, A, terms = x3(t), rotation(t), linear_terms(t)
    return aslo.Linear(terms.c, terms.d, derivative(x3, t) - A @ x, A)


@pytest.mark.parametrize("terms", [linear_terms, affine_linear_terms])
@pytest.mark.parametrize("name", FILTERS)
def test_swapped_linear_rows_hold(terms, name):
    check(rows_by_filter(terms, swaps=2)[name], x3)


def test_with_the_papers_start_rows_that_vary_begin_at_zero():
    """Both sides of a linear equation are filtered from there, and it holds at once."""
    observer = RowObserver(FromInput(), FILTERS["low pass"], swaps=1, start="paper")
    check(rows_of(observer, linear_terms), x3)


@pytest.mark.parametrize("terms", [linear_terms, affine_linear_terms])
def test_the_drift_of_terms_is_the_derivative_of_x(terms):
    t = jnp.asarray(0.8)
    np.testing.assert_allclose(terms(t).drift(x3(t)), derivative(x3, t), rtol=1e-14)


@pytest.mark.parametrize("Q", [np.asarray(0.7), np.array([[0.7, -0.2], [-0.2, 1.9]])])
def test_a_quadratic_term_times_a_vector(Q):
    x, zero = np.array([1.3, -0.4]), jnp.zeros(2)
    terms = aslo.Quadratic(jnp.asarray(Q), zero, jnp.zeros(()), zero)
    expected = (Q if Q.ndim else Q * np.eye(2)) @ x
    np.testing.assert_allclose(terms.times(jnp.asarray(x)), expected, rtol=1e-15)


@pytest.mark.parametrize("terms", [rate_terms, affine_rate_terms])
@pytest.mark.parametrize("name", STRICTLY_PROPER)
@pytest.mark.parametrize("swaps", [0, 1])
def test_rate_rows_hold(terms, name, swaps):
    check(rows_by_filter(terms, swaps, strictly_proper=True)[name], x3)


@functools.cache
def quadratic(n):
    rng = np.random.default_rng(n)
    Q = rng.normal(size=(n, n))
    Q = jnp.asarray(Q + Q.T)  # indefinite
    phase, speed = jnp.asarray(rng.normal(size=(2, n)))

    def x(t):
        return jnp.sin(speed * t + phase) + 0.3

    def terms(t):
        c = jnp.cos(phase * t) * speed + 0.5
        d = 0.5 * x(t) @ Q @ x(t) - c @ x(t)
        return aslo.Quadratic(Q, c, d, derivative(x, t))

    assert np.linalg.eigvalsh(Q).min() < 0 < np.linalg.eigvalsh(Q).max()
    return x, terms


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("name", FILTERS)
def test_quadratic_rows_hold(n, name):
    x, terms = quadratic(n)
    check(rows_by_filter(terms)[name], x)


def test_a_constant_in_d_drops_out():
    x, terms = quadratic(2)

    def shifted(t):
        return eqx.tree_at(lambda q: q.d, terms(t), terms(t).d + 3.7)

    observer = RowObserver(FromInput(), aslo.LowPass(2.0))
    rows, shifted_rows = rows_of(observer, terms), rows_of(observer, shifted)
    np.testing.assert_allclose(shifted_rows.b, rows.b, atol=1e-12)
    check(shifted_rows, x)


def test_swapping_lemma_against_direct_filtering():
    # F[c'x] filtered as it is, and by the lemma without a look at c'x.
    class Both(AbstractObserver):
        filter: aslo.AbstractFilter

        def equations(self, F, u, y):
            F = F.using(self.filter)
            x, c, z = u
            direct = F(jnp.sum(c * x), "direct")
            X = F.hidden(F.inject(c), "X")
            E = F.hidden(jnp.sum(X * z, axis=-1), "E")
            r = F.output(X) + F.filter.feedthrough(c)
            return direct, jnp.sum(r * x) - F.output(E)

    together = Together({name: Both(filter) for name, filter in FILTERS.items()})
    terms = lambda t: (x3(t), c3(t), derivative(x3, t))
    for direct, swapped in rows_of(together, terms).values():
        np.testing.assert_allclose(swapped, direct, atol=1e-12)
        assert np.abs(direct).max() > 0.5


@pytest.mark.parametrize("start", ["exact", "paper"])
def test_row_of_the_pmsm_is_the_printed_one(start):
    """w4, w5, w6 of Prop. 2, filtered one by one as printed; with the exact start they
    carry F[1] where the print has 1 and use no pF."""
    motor, lam = PrescribedPMSM(), 5.0
    R, L, m = motor.resistance, motor.inductance, motor.magnet_flux

    class Printed(AbstractObserver):
        def equations(self, F, u, y):
            F = F.using(aslo.LowPass(lam), start)
            z = u - R * y
            minus_z3 = m**2 / (2 * L) - 0.5 * L * jnp.sum(y**2)
            rho = F.one()
            Fy, Fz = F(y), F(rho * z)
            w45 = Fy - rho * y + Fz / (lam * L)
            products = F(jnp.sum(z * Fy)) + F(jnp.sum(z * Fz)) / (lam * L)
            w6 = rho * minus_z3 - F(minus_z3) + products / lam
            return w45, w6

    signals = motor.voltage, motor.current, TS
    w45, w6 = observe(Printed(), *signals)
    observer = RowObserver(motor.relation(), aslo.LowPass(lam), start=start)
    row = observe(observer, *signals)
    np.testing.assert_allclose(row.r, w45, rtol=1e-8, atol=1e-13)
    np.testing.assert_allclose(row.b, w6, rtol=1e-8, atol=1e-13)


def test_rate_rows_refuse_a_filter_with_feedthrough():
    terms = rate_terms(jnp.zeros(()))
    observer = RowObserver(FromInput(), FILTERS["general"])
    with pytest.raises(ValueError, match="must be strictly proper for a rate relation"):
        observer.init(jnp.zeros(()), terms)
