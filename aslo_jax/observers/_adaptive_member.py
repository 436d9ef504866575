"""One of the Kalman filters of [`Adaptive`][]: its belief, and a step of it."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from .._factored import Rows, array, dot, less, plus, stacked, times
from .._small import safe_reciprocal
from .._sparsity import listed
from ._adaptive_model import Model, Turn, distance, motion_by_errors, spread_of
from ._lifted_filter import grown
from ._lifting import entries, matrix, scaled, squares, total

SMOOTHING = 50.0  # rad/s, of the y in slopes, in the frame that turns with the row
# It follows y at once where that is away by more than so many times the variance of noise:
# in a transient, slopes at a y that lags claim what the samples do not tell.
FOLLOWED = 8.0
# Below so many times the variance of noise alone, what is not known of x counts for nothing
# against a member: ten thousand samples make much of a thousandth of a variance.
LEAST = 1.3
LEARNING = 0.3  # s in which information must come to be more than what noise feigns
AVERAGE = 0.05  # s


class Member(NamedTuple):
    """Kalman filters: `mean` of x and the relative errors of the parameters, shape
    `(n + q,)`, and their covariance; y for slopes, now and `ahead`, at the next sample, and
    its direction in the row, shape `(p,)`; how fast it learns of the first parameter (1/s);
    the logarithm of a weight."""

    mean: Float[Array, "*j N"]
    covariance: Float[Array, "*j N N"]
    smooth: Float[Array, "*j p"]
    ahead: Float[Array, "*j p"]
    direction: Float[Array, "*j p"]
    learning: Float[Array, "*j"]
    score: Float[Array, "*j"]


def stepped(
    model: Model,
    m: Member,
    hold: Float[Array, ""],
    drift: Float[Array, " q"],
    sample: Any,
    age: Float[Array, ""] | None = None,
) -> tuple[Member, Bool[Array, ""], Float[Array, ""]]:
    """A filter after an interval, with the y at its end, and whether it holds the
    parameters. `sample` is u, both y, how many samples in a row are missing, or `None`, and
    the interval (s). Where it has rivals, all of which have an `age` (s), what its score
    loses."""
    u, y0, y1, hole, h = sample
    q = len(model.parameters)
    flat, unflat = ravel_pytree(y1)
    dtype, n = m.mean.dtype, m.mean.shape[0] - q
    x, errors = m.mean[:n], m.mean[n:]
    where_seen = lambda e: e if hole is None else jnp.where(hole > 0.0, 0.0, e)
    moved = x + 0.5 * h * (model.row(errors, u, y0).z + model.row(errors, u, y1).z)
    noise = model.noise(errors, u, y1)
    # Each y is in the two intervals that it is between, a half in each.
    by_u, by_y = scaled(noise.z_by_u, h), scaled(noise.z_by_y, 0.5 * h)
    E = scaled(listed(motion_by_errors, model, errors, u, unflat(m.ahead)), h)
    halves = squares(by_y)
    P = _moved(matrix(m.covariance), E, total(squares(by_u), halves))
    for k in range(q):
        P[n + k][n + k] = P[n + k][n + k] + h * drift[k] ** 2
    if hole is not None:
        lost = grown(hole) * jnp.sum((moved - x) ** 2)
        for i in range(n):
            P[i][i] = P[i][i] + lost

    X = entries(moved) + entries(errors)
    d = distance(model, X, u, y1, m.ahead)
    bent = d.bent([row[:n] for row in P[:n]])
    shared = [dot(row, d.by_y) for row in by_y] + [0] * q
    Pa = [plus(dot(row, d.slope), e) for row, e in zip(P, shared, strict=True)]
    both = [plus(a, b) for a, b in zip(Pa, shared, strict=True)]
    S = dot(d.slope, both) + d.size + 0.5 * _of_square(bent)
    known = d.size > 0
    inverse = jnp.where(known, 1.0 / jnp.where(known, S, 1.0), 0.0)
    surprise = d.value - d.mean - 0.5 * sum(bent[i][i] for i in range(n))
    # What a row tells of the noise of y, half of which will be in the next interval.
    columns = zip(*by_y, strict=True)
    told = [
        plus(dot(d.slope[:n], list(c)), e) for c, e in zip(columns, d.by_y, strict=True)
    ]
    full = [plus(e, dot(row, told)) for e, row in zip(Pa, by_y, strict=False)] + Pa[n:]
    gain = [e * inverse for e in full]
    share = (Pa[n] / P[n][n]) ** 2 * inverse / h
    learning = m.learning + jnp.minimum(h / AVERAGE, 1.0) * (share - m.learning)
    held = (P[n][n] > hold**2) & (learning * hold**2 * LEARNING < 1.0)
    # Parameters that are held still tell of x what they tell.
    kept = gain[:n] + [jnp.where(held, 0.0, e) for e in gain[n:]]
    for i in range(n + q):
        for j in range(i, n + q):
            drop = full[i] * (gain if i < n else kept)[j]
            more = less(times(3.0, halves[i][j]), drop) if j < n else -drop
            P[i][j] = P[j][i] = P[i][j] + where_seen(more)
    step = where_seen(surprise)
    after = [e - g * step for e, g in zip(X, kept, strict=True)]

    turn = Turn.between(m.direction, stacked(d.by_y, dtype), d.size)
    smooth = turn.of(m.smooth)
    away = jnp.mean(((flat - smooth) / spread_of(model, y1)) ** 2)
    weight = jnp.minimum(h * SMOOTHING, 1.0)
    loss = jnp.zeros_like(S)
    if age is not None:
        weight = jnp.minimum(jnp.maximum(weight, h / (age + h)), 1.0)
        # By the variance that noise of the sample alone would have, which differs from
        # member to member, and with it how likely any y is, by as much: that cancels.
        own = 1.0 / dot(told, told)
        over = jnp.maximum(S * own, LEAST)
        loss = where_seen(0.5 * (surprise * surprise * own / over + jnp.log(over)))
    weight = jnp.maximum(weight, 1.0 - FOLLOWED * safe_reciprocal(away))
    smooth = smooth + where_seen(weight) * (flat - smooth)
    # The row will turn by as much again.
    beside = smooth, turn.of(smooth), turn.direction, learning, m.score
    return Member(stacked(after, dtype), array(P, dtype), *beside), held, loss


def _moved(P: Rows, E: Rows, W: Rows) -> Rows:
    """The covariance of `(x + E errors + noise, errors)`, the noise with the covariance W,
    from that of `(x, errors)`."""
    n, size = len(E), len(P)
    cross = [
        [
            plus(P[i][j], dot(E[i], [P[k][j] for k in range(n, size)]))
            for j in range(n, size)
        ]
        for i in range(n)
    ]
    found = [list(row) for row in P]
    for i in range(n):
        found[i][n:] = cross[i]
        for j in range(n, size):
            found[j][i] = cross[i][j - n]
        for j in range(i, n):
            moved = plus(dot(E[i], P[j][n:]), dot(cross[i], E[j]))
            found[i][j] = found[j][i] = plus(plus(P[i][j], W[i][j]), moved)
    return found


def _of_square(B: Rows) -> Any:
    """The trace of `B B`."""
    columns = [list(column) for column in zip(*B, strict=True)]
    return sum(dot(row, column) for row, column in zip(B, columns, strict=True))


def mirrored(P: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """A symmetric matrix by what is above its diagonal."""
    above = np.triu(np.ones(P.shape, bool))
    return jnp.where(above, P, P.T)
