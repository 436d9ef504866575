"""Several rows at once, and quadratic rows in a frame that turns: identities for all t > 0,
and the state that they give."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_relations import (
    STRICTLY_PROPER,
    TS,
    FromInput,
    affine_linear_terms,
    affine_rate_terms,
    check,
    derivative,
    linear_terms,
    rate_terms,
    rows_by_filter,
    rows_of,
    x3,
)

import aslo_jax as aslo


def several(rate, linear):
    """A rate row and a linear one, of different units."""

    def terms(t):
        a, b = rate(t), linear(t)
        C, d = jnp.stack([a.c, 40.0 * b.c]), jnp.stack([a.d, 40.0 * b.d])
        return aslo.Rows(C, d, a.s[None], a.z, a.A)

    return terms


TERMS = [several(rate_terms, linear_terms), several(affine_rate_terms, affine_linear_terms)]


@pytest.mark.parametrize("terms", TERMS, ids=["plain", "affine"])
@pytest.mark.parametrize("name", STRICTLY_PROPER)
@pytest.mark.parametrize("swaps", [0, 1])
def test_several_rows_hold(terms, name, swaps):
    rows = rows_by_filter(terms, swaps, strictly_proper=True)[name]
    assert rows.r.shape == (len(TS), 2, 3)
    x = jax.vmap(x3)(TS)
    for r, b in zip(rows.r.swapaxes(0, 1), rows.b.T, strict=True):
        np.testing.assert_allclose(jnp.sum(r * x, -1) - b, 0, atol=4e-10)
        assert np.abs(b[3:]).min() > 1e-3


@pytest.mark.parametrize("terms", TERMS, ids=["plain", "affine"])
@pytest.mark.parametrize(
    "completion",
    [
        aslo.Repeat(),
        aslo.FilterBank([aslo.LowPass(7.0), aslo.LowPass(11.0)]),
        aslo.LeastSquares(aslo.LowPass(9.0)),
    ],
    ids=["repeat", "bank", "least-squares"],
)
def test_every_completion_solves_several_rows(terms, completion):
    observer = aslo.AlgebraicObserver(FromInput(), aslo.LowPass(4.0), completion, None)
    estimate = rows_of(observer, terms)
    error = np.asarray(estimate.value - jax.vmap(x3)(TS))[2:]
    np.testing.assert_allclose(error, 0.0, atol=1e-6)
    certificate = np.asarray(estimate.certificate)[2:]
    assert np.all((certificate > 1e-15) & (certificate <= 1.0 + 1e-12))


def test_rows_without_a_rate_hold():
    def terms(t):
        a = linear_terms(t)
        return aslo.Rows(a.c[None], a.d[None], jnp.zeros(0), a.z)

    observer = aslo.AlgebraicObserver(FromInput(), aslo.LowPass(4.0), aslo.Repeat(), None)
    estimate = rows_of(observer, terms)
    np.testing.assert_allclose(estimate.value[2:], jax.vmap(x3)(TS)[2:], atol=1e-6)


def turning(t):
    """`|x - p|^2 = constant`, seen from a frame that turns: `Q A + A'Q = 0`."""
    x, w = x3(t), jnp.stack([0.7 + 0.2 * jnp.sin(t), -0.4 + 0.0 * t, 0.3 * jnp.cos(t)])
    A = jnp.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]]) * w[0]
    A = A + jnp.array([[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]]) * w[1]
    A = A + jnp.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]]) * w[2]
    c = jnp.stack([jnp.cos(2 * t), 0.4 * t, jnp.sin(t) - 1.0])
    d = 0.5 * 0.7 * x @ x - c @ x
    return aslo.Quadratic(jnp.asarray(0.7), c, d, derivative(x3, t) - A @ x, A)


@pytest.mark.parametrize("swaps", [0, 1])
def test_quadratic_rows_hold_in_a_frame_that_turns(swaps):
    for rows in rows_by_filter(turning, swaps).values():
        check(rows, x3)


@pytest.mark.parametrize(
    ("C", "d", "s", "expected"),
    [
        ((2, 3), 2, 3, r"`s` of a relation"),
        ((3, 3), 2, 1, r"`C` of a relation"),
        ((1, 3), 2, 2, r"`C` of a relation"),
    ],
)
def test_rows_of_another_shape_are_refused(C, d, s, expected):
    terms = aslo.Rows(jnp.ones((2, 3)), jnp.ones(2), jnp.ones(2), jnp.ones(3))
    wrong = jnp.ones(C), jnp.ones(d), jnp.ones(s)
    terms = eqx.tree_at(lambda r: (r.C, r.d, r.s), terms, wrong)
    with pytest.raises(ValueError, match=expected):
        terms.check(FromInput())


def test_too_few_filters_for_several_rows_are_refused():
    bank = aslo.FilterBank([])
    observer = aslo.AlgebraicObserver(FromInput(), aslo.LowPass(4.0), bank, None)
    terms = TERMS[0](jnp.zeros(()))
    with pytest.raises(ValueError, match="at least n/2 - 1 = 1 filters for a state of 3"):
        observer.init(jnp.zeros(()), terms)


class FromMeasurement(eqx.Module):
    """A relation whose terms arrive as the measurement."""

    def __call__(self, u, y):
        del u
        return y


def test_as_many_rows_as_entries_need_no_filters():
    C = jnp.array([[1.0, 0.4, -0.2], [0.3, -2.0, 0.5], [0.0, 0.7, 30.0]])

    def terms(t):
        return aslo.Rows(C, C @ x3(t), jnp.zeros(0), derivative(x3, t), constant=True)

    times = 0.01 * jnp.arange(80)
    bank = aslo.FilterBank([])
    observer = aslo.AlgebraicObserver(FromMeasurement(), aslo.LowPass(4.0), bank, None)
    terms = jax.jit(jax.vmap(terms))(times)
    found = aslo.replay(observer, times, jnp.zeros(times.size), terms)
    np.testing.assert_allclose(found.value[2:], jax.vmap(x3)(times)[2:], atol=1e-5)
    assert found.certificate[-1] > 0.05
