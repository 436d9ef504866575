"""Prediction errors of a log, and the Kalman filter that makes white noise of them.

The state is x and the noise n of the present measurement, since the current that is
measured wrong also carries the flux on: `x1 = step(x, y0 - n0, y1 - n1)`. The relation then
holds without noise, `gap(x, u, y - n) = 0`, and is the measurement.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .predict import AbstractPrediction


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

    gain: Float[Array, "N s g"]
    whiten: Float[Array, "N g g"]


def _predict(prediction, s, n1, w, u, y0, y1, h, bend):
    p = y0.shape[0]
    x, n0 = s[:-p], s[-p:]
    ends = (y0 - n0 + bend, y1 - n1 + bend)
    return jnp.concatenate([prediction.step(x, w, u, ends, h), n1])


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


def kalman(
    prediction: AbstractPrediction,
    x0: Float[Array, " n"],
    noise: Noise,
    signals: Signals,
) -> tuple[Gains, Array, Array]:
    """The gains of the extended Kalman filter along the log, from an x0 that is taken to
    be right, the negative log-likelihood per row, and the half logarithm of the variance of
    all errors, of which it has one row's share."""
    h, u, y = signals
    p, w = y.shape[1], jnp.zeros_like(noise.drift)
    n0 = jnp.zeros(p)

    def update(s, P, u, y, B):
        e, H = _measure(prediction, s, u, y, B * noise.reference)
        S = H @ P @ H.T
        whiten = _inverse_root(S)
        K = P @ H.T @ whiten.T @ whiten
        white = whiten @ e
        size = -jnp.sum(jnp.log(jnp.diagonal(whiten)))
        cost = jnp.stack([0.5 * jnp.sum(white * white) + size, size])
        return s - K @ e, P - K @ S @ K.T, Gains(K, whiten), cost

    def body(carry, sample):
        s, P = carry
        h, u, y0, y1, bend = sample
        law = lambda s, n, w: _predict(prediction, s, n, w, u, y0, y1, h, bend)
        A, B, C = jax.jacfwd(law, (0, 1, 2))(s, n0, w)
        Bn, Cn = B * noise.output, C * noise.drift
        P = A @ P @ A.T + Bn @ Bn.T + Cn @ Cn.T
        s, P, gains, cost = update(law(s, n0, w), P, u, y1, B)
        return (s, P), (gains, cost)

    s = jnp.concatenate([x0, n0])
    B = jnp.concatenate([jnp.zeros((x0.size, p)), jnp.eye(p)])
    s, P, first, cost = update(s, (B * noise.output) @ (B * noise.output).T, u[0], y[0], B)
    rows = (h, u[:-1], y[:-1], y[1:], prediction.bend(h, u, y))
    _, (gains, costs) = jax.lax.scan(body, (s, P), rows)
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
    h, u, y = signals
    p, w = y.shape[1], jnp.zeros(len(prediction.disturbed))
    n0 = jnp.zeros(p)

    def update(s, u, y, gains, B):
        e, _ = _measure(prediction, s, u, y, B * reference)
        return s - gains.gain @ e, gains.whiten @ e

    def body(s, sample):
        h, u, y0, y1, bend, gains = sample
        law = lambda n: _predict(prediction, s, n, w, u, y0, y1, h, bend)
        return update(law(n0), u, y1, gains, jax.jacfwd(law)(n0))

    B = jnp.concatenate([jnp.zeros((x0.size, p)), jnp.eye(p)])
    first, rest = jax.tree.map(lambda a: a[0], gains), jax.tree.map(lambda a: a[1:], gains)
    s, e0 = update(jnp.concatenate([x0, n0]), u[0], y[0], first, B)
    rows = (h, u[:-1], y[:-1], y[1:], prediction.bend(h, u, y), rest)
    _, later = jax.lax.scan(body, s, rows)
    return jnp.concatenate([e0[None], later])
