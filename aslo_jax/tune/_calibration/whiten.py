"""Prediction errors of a log, and the Kalman filter that makes white noise of them.

The state is x and the noise n of the present measurement, since the current that is
measured wrong also carries the flux on: `x1 = step(x, y0 - n0, y1 - n1)`. The relation then
holds without noise, `gap(x, u, y - n) = 0`, and is the measurement.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .predict import AbstractPrediction, Turn, turns


class Signals(NamedTuple):
    """A log: intervals (s), shape `(N - 1,)`, inputs and outputs with `N` rows."""

    h: Float[Array, " N-1"]
    u: Float[Array, "N m"]
    y: Float[Array, "N p"]


class Noise(NamedTuple):
    """Standard deviations: `output` of every sample of y, shape `(p,)`, and `drift` of what
    disturbs the derivatives of x, held from sample to sample, shape `(w,)`. `reference` is
    an output noise that stays the same, shape `(p,)`, by which errors are measured."""

    output: Float[Array, " p"]
    drift: Float[Array, " w"]
    reference: Float[Array, " p"]


class Gains(NamedTuple):
    """Of every row: the filter's gain, and the factor that whitens its error."""

    gain: Float[Array | np.ndarray, "*N s g"]
    whiten: Float[Array | np.ndarray, "*N g g"]


def _predict(prediction, s, n1, w, row):
    p = row.y0.shape[0]
    x, n0 = s[:-p], s[-p:]
    bend = prediction.bend(row.h, row.u, row.y0, row.turn)
    ends = (row.y0 - n0 + bend, row.y1 - n1 + bend)
    return jnp.concatenate([prediction.step(x, w, row.u, ends, row.h), n1])


def _inverse_root(S: Float[Array, "g g"]) -> Float[Array, "g g"]:
    """Of the Cholesky factor of S."""
    if S.shape[0] == 1:
        return 1.0 / jnp.sqrt(S)
    factor = jnp.linalg.cholesky(S)
    return jax.scipy.linalg.solve_triangular(factor, jnp.eye(S.shape[0]), lower=True)


def _measure(prediction, s, u, y, B):
    """The error and its derivative in s, measured by what the noise of this sample makes
    of it: `B` is how that, of unit size, enters s.

    The likelihood of y needs the gap in the units of y. Its own would reward a parameter
    that makes every gap small, such as an inductance that goes to zero."""
    p = y.shape[0]

    def gap(s):
        return prediction.gap(s[:-p], u, y - s[-p:])

    H = jax.jacfwd(gap)(s)
    D = H @ B
    scale = _inverse_root(D @ D.T)
    return scale @ gap(s), scale @ H


class Row(NamedTuple):
    """What the filter sees of an interval: its length `h` (s), the `u` held in it, the y at
    its two ends, and how both turn about it."""

    h: Float[Array, ""]
    u: Float[Array, " m"]
    y0: Float[Array, " p"]
    y1: Float[Array, " p"]
    turn: Turn


def rows_of(signals: Signals) -> Row:
    """All of them, each with an axis of intervals in front."""
    h, u, y = signals
    return Row(h, u[:-1], y[:-1], y[1:], turns(h, u, y))


def filter_first(
    prediction: AbstractPrediction,
    x0: Float[Array, " n"],
    noise: Noise,
    u: Float[Array, " m"],
    y: Float[Array, " p"],
) -> tuple[tuple[Array, Array], tuple[Gains, Array]]:
    """The filter after the first sample, its state and the covariance of that; with the
    gains, the negative log-likelihood, and the half logarithm of the error's variance."""
    s, B = _begun(x0, y)
    P = (B * noise.output) @ (B * noise.output).T
    return _filtered(prediction, noise, s, P, u, y, B)


def filter_step(
    prediction: AbstractPrediction, noise: Noise, carry: tuple[Array, Array], row: Row
) -> tuple[tuple[Array, Array], tuple[Gains, Array]]:
    """The filter after one more sample, as [`filter_first`][]."""
    s, P = carry
    n0, w = jnp.zeros_like(row.y0), jnp.zeros_like(noise.drift)
    law = lambda s, n, w: _predict(prediction, s, n, w, row)
    A, B, C = jax.jacfwd(law, (0, 1, 2))(s, n0, w)
    Bn, Cn = B * noise.output, C * noise.drift
    P = A @ P @ A.T + Bn @ Bn.T + Cn @ Cn.T
    return _filtered(prediction, noise, law(s, n0, w), P, row.u, row.y1, B)


def _filtered(prediction, noise, s, P, u, y, B):
    e, H = _measure(prediction, s, u, y, B * noise.reference)
    S = H @ P @ H.T
    whiten = _inverse_root(S)
    K = P @ H.T @ whiten.T @ whiten
    white = whiten @ e
    size = -jnp.sum(jnp.log(jnp.diagonal(whiten)))
    cost = jnp.stack([0.5 * jnp.sum(white * white) + size, size])
    return (s - K @ e, P - K @ S @ K.T), (Gains(K, whiten), cost)


def _begun(x0, y):
    """The state before the first sample, and how that one's noise enters it."""
    p = y.shape[0]
    B = jnp.concatenate([jnp.zeros((x0.size, p)), jnp.eye(p)])
    return jnp.concatenate([x0, jnp.zeros(p)]), B


def error_first(
    prediction: AbstractPrediction,
    x0: Float[Array, " n"],
    reference: Float[Array, " p"],
    u: Float[Array, " m"],
    y: Float[Array, " p"],
    gains: Gains,
) -> tuple[Array, Array]:
    """The state after the first sample, with the gains as they are, and its white error."""
    s, B = _begun(x0, y)
    return _corrected(prediction, reference, s, u, y, B, gains)


def error_step(
    prediction: AbstractPrediction,
    reference: Float[Array, " p"],
    s: Float[Array, " s"],
    row: Row,
    gains: Gains,
) -> tuple[Array, Array]:
    """The state after one more sample, and its white error."""
    n0, w = jnp.zeros_like(row.y0), jnp.zeros(len(prediction.disturbed))
    law = lambda n: _predict(prediction, s, n, w, row)
    B = jax.jacfwd(law)(n0)
    return _corrected(prediction, reference, law(n0), row.u, row.y1, B, gains)


def _corrected(prediction, reference, s, u, y, B, gains):
    e, _ = _measure(prediction, s, u, y, B * reference)
    return s - gains.gain @ e, gains.whiten @ e


def kalman(
    prediction: AbstractPrediction,
    x0: Float[Array, " n"],
    noise: Noise,
    signals: Signals,
) -> tuple[Gains, Array, Array]:
    """The gains of the extended Kalman filter along the log, from an x0 that is taken to
    be right, the negative log-likelihood per row, and the half logarithm of the variance of
    all errors, of which it has one row's share."""
    _, u, y = signals
    carry, (first, cost) = filter_first(prediction, x0, noise, u[0], y[0])
    step = lambda carry, row: filter_step(prediction, noise, carry, row)
    rows = rows_of(signals)
    _, (gains, costs) = jax.lax.scan(step, carry, rows)
    gains = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, gains)
    cost, size = cost + jnp.sum(costs, axis=0)
    return gains, cost / y.shape[0], size


def errors(
    prediction: AbstractPrediction,
    x0: Float[Array, " n"],
    reference: Float[Array, " p"],
    gains: Gains,
    signals: Signals,
) -> Float[Array, "N g"]:
    """The whitened prediction errors, with the gains as they are: of unit size and white
    where the model is right."""
    _, u, y = signals
    first, rest = jax.tree.map(lambda a: a[0], gains), jax.tree.map(lambda a: a[1:], gains)
    s, e0 = error_first(prediction, x0, reference, u[0], y[0], first)
    step = lambda s, row: error_step(prediction, reference, s, *row)
    rows = rows_of(signals)
    _, later = jax.lax.scan(step, s, (rows, rest))
    return jnp.concatenate([e0[None], later])
