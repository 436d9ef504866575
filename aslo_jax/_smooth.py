"""Smoothing of a log: each estimate from what came before and after it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ._checked_log import checked_log
from ._checks import unlike
from ._factored import unpacked
from ._typing import PyTree
from .observers import AbstractObserver, Estimate, Lifted
from .observers._lifted_filter import LiftedBelief, Stage
from .observers._lifting import entries, rows_of


def smooth(
    observer: AbstractObserver, t: ArrayLike, u: PyTree[ArrayLike], y: PyTree[ArrayLike]
) -> Estimate:
    """The estimate at every instant of a log from the whole log, later samples too:
    fixed-interval smoothing on the Kalman filter of a relation.

    - `observer`: a [`Lifted`][];
    - `t`, shape `(N,)`; `u` and `y`, as of [`replay`][].

    The filter runs forward, and the information of what follows backward; each estimate
    weighs the two. Beside the filter's the error of a motor's flux is 1.2 to 1.4 times
    smaller, and the start of the log is as good as the rest.

    **Returns:** an [`Estimate`][] whose leaves have a leading axis of length `N`, with the
    covariance of each value. It coasts where the whole log does not tell what x is.
    Differentiable; `jax.vmap` maps it.

    **Raises:** `ValueError` for another observer, and as [`replay`][].

    Source: Rauch, Tung, Striebel 1965, doi:10.2514/3.3166, in the form of two filters,
    which needs no inverse of a covariance: Fraser, Potter 1969,
    doi:10.1109/TAC.1969.1099196.
    """
    if not isinstance(observer, Lifted):
        raise unlike("observer", observer, "a `Lifted`")
    log, common = checked_log(t, u, y)
    return _smooth(observer, log, common)


@eqx.filter_jit
def _smooth(observer: Lifted, log: Any, common: Any) -> Estimate:
    _, u, y, intervals = log
    law = observer.law
    u0, y0 = jax.tree.map(lambda s: s[0], (u, y))
    n = rows_of(observer.relation, u0, y0)[0].z.shape[0]
    first = law.start(u0, y0)
    if intervals is None:
        count = jax.tree.leaves(y)[0].shape[0] - 1
        intervals = jnp.broadcast_to(common, (count,))

    def forward(belief, sample):
        u, y0, y1, h = sample
        belief, stage = law.stage(belief, (u, y0), (u, y1), h)
        return belief, (belief, stage)

    held, before = (jax.tree.map(lambda s: s[:-1], s) for s in (u, y))
    after = jax.tree.map(lambda s: s[1:], y)
    _, (beliefs, stages) = jax.lax.scan(forward, first, (held, before, after, intervals))

    def backward(future, both):
        belief, stage = both
        information, vector = future
        found = _weighed(belief, information, vector, n)
        return _before(stage, information, vector), found

    size = first.mean.shape[0]
    nothing = jnp.zeros((size, size), first.mean.dtype), jnp.zeros_like(first.mean)
    future, (x, P) = jax.lax.scan(backward, nothing, (beliefs, stages), reverse=True)
    x0, P0 = _weighed(first, future[0], future[1], n)
    x, P = (jnp.concatenate([a[None], b]) for a, b in ((x0, x), (P0, P)))

    def judged(u, y, x, P):
        rows = rows_of(observer.relation, u, y)
        certificate = observer.certificate(rows, x, [entries(row) for row in P])
        guard = observer.guard
        coasting = jnp.asarray(False) if guard is None else ~guard.certified(certificate)
        return Estimate(x, certificate, coasting, P)

    return jax.vmap(judged)(u, y, x, P)


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
