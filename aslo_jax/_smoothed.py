"""The Kalman filter of a relation forward over a log, and the information of what follows
backward."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._factored import unpacked
from ._typing import PyTree
from .observers import Estimate, Lifted
from .observers._lifted_filter import LiftedBelief, LiftedKalman, Stage
from .observers._lifting import entries, rows_of
from .observers._missing import Gap, either, finite, whole, zeros


@eqx.filter_jit
def smoothed(observer: Lifted, log: Any, common: Any, coasts: bool) -> "Smoothed":
    """What is known at all instants of a `log` that has been checked; `coasts`: whether
    samples may be missing in it."""
    _, u, y, intervals = log
    if intervals is None:
        count = jax.tree.leaves(y)[0].shape[0] - 1
        intervals = jnp.broadcast_to(common, (count,))
    first, passed, signals, missing = _filtered(observer.law, u, y, intervals, coasts)
    n = rows_of(observer.relation, *jax.tree.map(lambda s: s[0], signals))[0].z.shape[0]

    def backward(future, both):
        belief, stage, cut = both
        information, vector = future
        found = _weighed(belief, information, vector, n)
        before = _before(stage, information, vector)
        # Where the filter begins again, the past and the future know nothing of each other.
        return jax.tree.map(lambda a: jnp.where(cut, 0.0, a), before), found

    size = first.mean.shape[0]
    nothing = jnp.zeros((size, size), first.mean.dtype), jnp.zeros_like(first.mean)
    future, (x, P) = jax.lax.scan(backward, nothing, passed, reverse=True)
    x0, P0 = _weighed(first, future[0], future[1], n)
    x, P = (jnp.concatenate([a[None], b]) for a, b in ((x0, x), (P0, P)))

    return Smoothed(signals, missing, x, P)


class Smoothed(NamedTuple):
    """Of all N rows: u and y, held where they are missing, and where they are, shape
    `(N,)`; x, shape `(N, n)`, and its covariance, shape `(N, n, n)`."""

    signals: tuple[PyTree, PyTree]
    missing: Bool[Array, " N"]
    x: Float[Array, "N n"]
    covariance: Float[Array, "N n n"]

    def judged(self, observer: Lifted) -> Estimate:
        """The estimates."""
        return jax.vmap(lambda *row: judged(observer, *row))(*self)


def judged(
    observer: Lifted, signals: tuple[PyTree, PyTree], missing: Array, x: Array, P: Array
) -> Estimate:
    """The estimate of a row from its u and y, whether they are missing, and what is known
    of x."""
    rows = rows_of(observer.relation, *signals)
    certificate = observer.certificate(rows, x, [entries(row) for row in P])
    guard = observer.guard
    coasting = jnp.asarray(False) if guard is None else ~guard.certified(certificate)
    return Estimate(x, certificate, coasting | missing, P)


class _Passed(NamedTuple):
    """What the filter did over an interval, its belief after it, and whether it has begun
    anew there."""

    belief: LiftedBelief
    stage: Stage
    cut: Bool[Array, ""]


def _filtered(
    law: LiftedKalman, u: PyTree, y: PyTree, intervals: Array, coasts: bool
) -> tuple[LiftedBelief, _Passed, tuple[PyTree, PyTree], Bool[Array, " N"]]:
    """The belief at the first row, what came of the intervals; u and y of all rows, held
    where they are missing, and where they are."""
    u0, y0 = jax.tree.map(lambda s: s[0], (u, y))
    there = finite(y0) if coasts else jnp.asarray(True)
    gap = Gap.before(u0, y0)[0]
    if coasts:
        y0, u0 = Gap.before(u0, y0)[1], either(finite(u0), u0, zeros(u0))
    first = law.start(u0, y0)
    no, none = jnp.asarray(False), jnp.zeros((), first.mean.dtype)

    def plainly(carry, sample):
        belief, before, *rest = carry
        u, y, h = sample
        belief, stage = law.stage(belief, (u, before), (u, y), h)
        return (belief, y, *rest), (_Passed(belief, stage, no), (u, y), no)

    def over_holes(carry, sample):
        """As `AbstractObserver.take` does it."""
        belief, before, gap, hole = carry
        u, y, h = sample
        now = whole(gap, before, u, y, h, None)
        begun = law.start(now.u, now.y)
        belief = jax.tree.map(lambda a, b: jnp.where(now.first, a, b), begun, belief)
        hole = jnp.where(now.missing, jnp.where(now.first, 0.0, hole) + 1.0, 0.0)
        blind = law.blind(hole, now.u, now.y)
        ends = (now.u, now.left), (now.u, now.y)
        belief, stage = blind.stage(belief, *ends, h)
        belief, again = blind.again(belief, *ends[1])
        passed = _Passed(belief, stage, now.first | again)
        return (belief, now.y, now.gap, hole), (passed, (now.u, now.y), now.missing)

    held, after = jax.tree.map(lambda s: s[:-1], u), jax.tree.map(lambda s: s[1:], y)
    run = over_holes if coasts else plainly
    carry = first, y0, gap, none
    _, (passed, rest, missing) = jax.lax.scan(run, carry, (held, after, intervals))
    join = lambda a, b: jnp.concatenate([a[None], b])
    signals = jax.tree.map(join, (u0, y0), rest)
    return first, passed, signals, join(~there, missing)


def _weighed(
    belief: LiftedBelief, information: Array, vector: Array, n: int
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """x and its covariance from the belief of the past and the information of the future:
    in units in which the belief has the covariance one."""
    U, d = unpacked(belief.factors)
    size = len(d)
    root = jnp.stack([jnp.stack([jnp.asarray(e, vector.dtype) for e in row]) for row in U])
    root = root * jnp.sqrt(jnp.stack(d))
    one = jnp.eye(size, dtype=vector.dtype)
    scaled = one + root.T @ information @ root
    gain = root @ jnp.linalg.solve(scaled, root.T)
    x = belief.mean + gain @ (vector - information @ belief.mean)
    P = 0.5 * (gain + gain.T)
    return x[size - n :], P[size - n :, size - n :]


def _before(stage: Stage, information: Array, vector: Array) -> tuple[Array, Array]:
    """The information on the state before a stage of the filter, from that after it.

    With `G e` the noise of the state and `B e + b` that of the values, e of unit variance
    and b of the stage's own: given the values, e has the mean `B'R^-1 (values - a - A X)`,
    `R = B B' + cov b`, and so the state moves with what the values tell of its noise."""
    T, H, G = stage.transition, stage.rows, stage.by_y
    out = H @ G + stage.own
    R = H @ stage.covariance @ H.T + out @ out.T + jnp.diag(stage.variances)
    GB = stage.covariance @ H.T + G @ out.T
    A, seen = H @ T, stage.values - H @ stage.shift
    told = jnp.linalg.solve(R, jnp.concatenate([A, seen[:, None], GB.T], axis=1))
    size = vector.shape[0]
    by_A, by_seen, by_GB = told[:, :size], told[:, size], told[:, size + 1 :]
    moved, shift = T - GB @ by_A, stage.shift + GB @ by_seen
    Q = stage.covariance + G @ G.T - GB @ by_GB
    vector = vector + jnp.sum(stage.information, axis=0)
    ahead = jnp.concatenate(
        [information @ moved, (vector - information @ shift)[:, None]], axis=1
    )
    one = jnp.eye(size, dtype=vector.dtype)
    ahead = moved.T @ jnp.linalg.solve(one + information @ Q, ahead)
    information = ahead[:, :size] + A.T @ by_A
    return 0.5 * (information + information.T), ahead[:, size] + A.T @ by_seen
