"""The Kalman filter of all velocities of a mechanical system in continuous time."""

from typing import Any

import jax.numpy as jnp

from .._factored import reciprocal
from .._factored_arrays import packed, unit_inverse, unpacked
from ._mechanical_belief import MechanicalBelief


def flow(law: Any, X: MechanicalBelief, u: Any, y: Any) -> MechanicalBelief:
    """The derivative of the belief of a `MechanicalKalman`, `P' = F P + P F' + W - K V K'`,
    in the factors of P, since `U^-1 P' U^-T` has d' on its diagonal and `U^-1 U' D` above
    it."""
    n, dtype = y.shape[0], y.dtype
    U, d = unpacked(X.factors), X.factors.pivots
    k = d.shape[0] - 2 * n
    # Without an interval there is no answer, and none that looks like one.
    h = jnp.asarray(jnp.nan if law.interval is None else law.interval, dtype)
    x, parameters = X.mean[: 2 * n], X.mean[2 * n :]
    slopes = law.motion.slopes(x, parameters, u)
    moving = jnp.eye(2 * n + k, dtype=dtype)[n : 2 * n]
    by_all = jnp.concatenate(slopes[:3], axis=1)
    F = jnp.concatenate([moving, by_all, jnp.zeros((k, 2 * n + k), dtype)])
    noise = jnp.zeros((2 * n + k, slopes.noise.shape[1]), dtype)
    noise = noise.at[n : 2 * n].set(slopes.noise)
    W = (noise * (h * law.variances(u))) @ noise.T
    if law.deviations.drift is not None:
        walk = jnp.concatenate([jnp.zeros(2 * n, dtype), law.deviations.drift**2])
        W = W + jnp.diag(walk)
    inverse = unit_inverse(U)
    FUd = (inverse @ F @ U) * d
    seen = U[:n] * d  # U D U' by y
    V = h * law.deviations.output**2
    pull = (y - x[:n]) / V
    M = FUd + FUd.T + inverse @ W @ inverse.T - seen.T @ (seen / V[:, None])
    rate = jnp.concatenate([law.motion.rate(x, parameters, u), jnp.zeros(k, dtype)])
    rate = rate + U @ (seen.T @ pull)
    above = jnp.triu(M * reciprocal(d), 1)
    return MechanicalBelief(rate, packed(U @ above, jnp.diagonal(M)))
