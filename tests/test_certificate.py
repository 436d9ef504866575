"""The certificate, and what it is measured against, beside NumPy: the harmonic mean of the
eigenvalues of the information matrix, whose columns are scaled by the size of the terms
that the row is the difference of."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from test_relations import (
    affine_linear_terms,
    affine_rate_terms,
    quadratic,
)
from test_rows import TERMS, turning

import aslo_jax as aslo
from aslo_jax.observers import AbstractObserver

FILTER = aslo.LinearFilter([[-3.0, 1.0], [-2.0, -4.0]], [0.7, 3.0], [1.0, 0.4])
BANK = aslo.LowPass(7.0), aslo.LowPass(1.7), aslo.LowPass(3.1)  # one more than are needed
FORGETTING = 6.0  # rad/s
INTERVAL = 0.02  # s
TIMES = INTERVAL * jnp.arange(60)
KINDS = {
    "linear, affine": affine_linear_terms,
    "rate, affine": affine_rate_terms,
    "matrix": quadratic(3)[1],
    "number": turning,
    "two": TERMS[0],
    "two, affine": TERMS[1],
}
LIKE_OTHERS = ("linear, affine", "two")


class Shown(AbstractObserver):
    """What completions solve and give, of terms that arrive as the measurement."""

    def equations(self, F, u, y):
        F = F.using(FILTER)
        row = y.row(F.scope("row"))
        again = aslo.swap(F.scope("again"), row)
        repeated = [row, again, aslo.swap(F.scope("third"), again)]
        other = [aslo.swap(F.scope(f"{k}").using(f), row) for k, f in enumerate(BANK)]
        completions = {
            "repeat": aslo.Repeat(),
            "bank": aslo.FilterBank(BANK),
            "least squares": aslo.LeastSquares(aslo.LowPass(FORGETTING)),
        }
        return {
            "repeat": [each.r for each in repeated],
            "bank": [row.r, *(each.r for each in other)],
            "scale": row.scale,
            "one": F.one("one"),
            "given": {
                name: completion(F.scope(name), row)[1]
                for name, completion in completions.items()
            },
        }


class Case(NamedTuple):
    name: str
    terms: eqx.Module
    found: dict

    def at(self, k):
        return jax.tree.map(lambda leaf: leaf[k], self.terms)


@pytest.fixture(
    scope="module",
    params=[pytest.param(k, marks=[pytest.mark.slow] * (k in LIKE_OTHERS)) for k in KINDS],
)
def case(request):
    terms = jax.jit(jax.vmap(KINDS[request.param]))(TIMES)
    found = aslo.replay(Shown(), TIMES, jnp.zeros(TIMES.size), terms)
    arrays = jax.tree.map(np.asarray, (terms, found))
    return Case(request.param, *arrays)


def harmonic(M):
    """The harmonic mean of its eigenvalues."""
    return len(M) / np.trace(np.linalg.inv(M))


def settled(c, A):
    """What the rows F[c'] settle at, where c and A do not vary: `A_f X + B c' = X A`."""
    n, k = len(c), len(FILTER.B)
    whole = np.kron(FILTER.A, np.eye(n)) - np.kron(np.eye(k), np.transpose(A))
    X = np.linalg.solve(whole, -np.kron(FILTER.B, c)).reshape(k, n)
    return np.asarray(FILTER.C) @ X


def sizes(c, A):
    return np.abs(c) if A is None else np.abs(c) + np.abs(settled(c, A))


@pytest.mark.parametrize("k", [1, 25, 59])
def test_what_a_row_is_measured_against(case, k):
    of, found = case.at(k), case.found
    if case.name.startswith("two"):
        # At the start, where A varies: it settles at nothing then.
        of = of if of.A is None else case.at(0)
        expected = np.sqrt(sum(sizes(c, of.A) ** 2 for c in of.C))
    elif case.name in ("matrix", "number"):
        subtracted = found["one"][k] * of.c
        parts = found["repeat"][0][k] + subtracted, subtracted
        expected = sum(np.abs(part) for part in parts)
        if case.name == "number":  # no direction is special
            expected = np.full(3, sum(map(np.linalg.norm, parts)) / 3**0.5)
    else:
        expected = sizes(of.c, of.A)
    np.testing.assert_allclose(found["scale"][k], expected, rtol=1e-9)


@pytest.mark.parametrize("name", ["repeat", "bank"])
def test_of_rows_that_are_solved(case, name):
    for k in (30, 59):
        R = np.concatenate([np.atleast_2d(rows[k]) for rows in case.found[name]])
        size = np.abs(R).max(axis=0)
        if case.name == "number":
            size = np.sqrt(np.sum(R * R, axis=1).max() / 3)
        R = R / (size + case.found["scale"][k])
        expected = harmonic(R.T @ R / len(R))
        assert 1e-14 < expected < 1.0
        np.testing.assert_allclose(case.found["given"][name][k], expected, rtol=1e-6)


def test_of_least_squares(case):
    """With A the information is carried along: the state of the left end of an interval
    is `expm(-h A)` times that of its right one."""
    hold = aslo.LowPass(FORGETTING).discretise(INTERVAL)
    a, left, right = hold.decay, FORGETTING * hold.left, FORGETTING * hold.right
    r = case.found["repeat"][0].reshape(TIMES.size, -1, 3)
    rr, scale = np.einsum("kri,krj->kij", r, r), case.found["scale"] ** 2
    A, M, size, S = case.terms.A, np.zeros((3, 3)), np.zeros(3), np.eye(3)
    for k in range(1, TIMES.size):
        if A is not None:
            S = scipy.linalg.expm(-0.5 * INTERVAL * (A[k - 1] + A[k]))
        M = S.T @ (a * M + left * rr[k - 1]) @ S + right * rr[k]
        size = a * size + left * scale[k - 1] + right * scale[k]
        if k in (30, 59):
            against = size if A is None else scale[k]
            if case.name == "two, affine":
                against = np.maximum(against, np.diag(M))
            expected = harmonic(M / np.sqrt(np.outer(against, against)))
            given = case.found["given"]["least squares"][k]
            np.testing.assert_allclose(given, expected, rtol=1e-6)


TURNING = np.array([[-0.4, 1.1, 0.0], [-0.9, -0.2, 0.5], [0.3, 0.0, -0.7]])  # 1/s
CONSTANT = np.array([1.3, -0.6, 0.8])
RATE = 4.0  # rad/s


def motion(t):
    return jnp.stack([jnp.sin(0.9 * t) + 0.5, jnp.cos(1.4 * t) - 0.2, 1.0 - 0.3 * t])


def observed(t):
    """`c'x = d + s'`, with c and A that do not vary."""
    x, rate = jax.jvp(motion, (t,), (jnp.ones_like(t),))
    s, s_rate = jax.jvp(lambda t: jnp.cos(0.8 * t) + 1.5, (t,), (jnp.ones_like(t),))
    c, A = jnp.asarray(CONSTANT), jnp.asarray(TURNING)
    return aslo.Rate(c, s, rate - A @ x, c @ x - s_rate, A, constant=True)


def stood(r, rate):
    """`-rate X + rate r' = X A`."""
    return rate * np.linalg.solve(rate * np.eye(3) + TURNING.T, r)


class Completed(AbstractObserver):
    completions: dict

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(RATE), "paper")
        row = y.row(F.scope("row"))
        return {
            name: completion(F.scope(name), row)
            for name, completion in self.completions.items()
        }


def test_with_the_papers_start_constant_rows_have_settled():
    """All that is constant of the equations is at its value from the beginning, where
    linear equations put it; what is measured settles."""
    times = 0.02 * jnp.arange(250)
    terms = jax.jit(jax.vmap(observed))(times)
    completions = {
        "repeat": aslo.Repeat(),
        "bank": aslo.FilterBank(BANK),
        "least squares": aslo.LeastSquares(aslo.LowPass(FORGETTING)),
    }
    found = aslo.replay(Completed(completions), times, jnp.zeros(times.size), terms)
    first = stood(CONSTANT, RATE)
    scale = np.abs(CONSTANT) + np.abs(first)
    again = stood(first, RATE)
    rows = {
        "repeat": [first, again, stood(again, RATE)],
        "bank": [first, *(stood(first, float(filter.rate)) for filter in BANK)],
    }
    half = 0.5 * FORGETTING * np.eye(3)
    M = FORGETTING * np.outer(first, first)
    M = scipy.linalg.solve_sylvester(TURNING.T + half, TURNING + half, M)
    expected = {"least squares": harmonic(M / np.outer(scale, scale))}
    for name, each in rows.items():
        R = np.array(each)
        R = R / (np.abs(R).max(axis=0) + scale)
        expected[name] = harmonic(R.T @ R / len(R))
    for name, (value, certificate) in found.items():
        np.testing.assert_allclose(certificate, expected[name], rtol=1e-8)
        error = np.abs(value - jax.vmap(motion)(times)).max(axis=1)
        assert error[10] > 0.3
        assert error[-1] < 0.02


class OfBoth(AbstractObserver):
    """The row of a relation, and that of the same one as a batch of one."""

    start: str

    def equations(self, F, u, y):
        F = F.using(FILTER, self.start)
        batch = aslo.Rows(y.c[None], y.d[None], y.s[None], y.z, y.A, constant=True)
        return y.row(F.scope("one")), batch.row(F.scope("batch"))


@pytest.mark.parametrize("start", ["exact", "paper"])
def test_one_of_several_rows_is_a_row(start):
    terms = jax.jit(jax.vmap(observed))(TIMES)
    one, batch = aslo.replay(OfBoth(start), TIMES, jnp.zeros(TIMES.size), terms)
    np.testing.assert_allclose(batch.r[:, 0], one.r, rtol=1e-12)
    np.testing.assert_allclose(batch.b[:, 0], one.b, rtol=1e-12)
    np.testing.assert_allclose(batch.scale, one.scale, rtol=1e-12)
    settled = start == "paper"
    assert np.all(one.r[0] == one.r[-1]) == settled
    assert np.all(one.r[0] == 0.0) != settled


class FromMeasurement(eqx.Module):
    """A relation whose terms arrive as the measurement."""

    def __call__(self, u, y):
        del u
        return y


def test_with_the_papers_start_a_schedule_that_stays_is_a_number():
    """Its constant rows are states, which stand where linear equations put them."""
    terms = jax.jit(jax.vmap(observed))(TIMES)
    found = [
        aslo.replay(
            aslo.AlgebraicObserver(
                FromMeasurement(), aslo.LowPass(rate), aslo.Repeat(), None, start="paper"
            ),
            TIMES,
            jnp.zeros(TIMES.size),
            terms,
        )
        for rate in (RATE, lambda t, u, y: RATE)
    ]
    np.testing.assert_allclose(found[1].certificate, found[0].certificate, rtol=1e-9)
    np.testing.assert_allclose(found[1].value[5:], found[0].value[5:], rtol=1e-7)
