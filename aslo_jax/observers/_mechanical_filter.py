"""The Kalman filter of all velocities of a mechanical system, as a law."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._factored_arrays import packed, propagated, unpacked, updated
from .._filters import AbstractLaw
from .._runge_kutta import runge_kutta
from .._typing import PyTree
from ._mechanical_belief import Deviations, MechanicalBelief
from ._mechanical_flow import flow
from ._motion import Motion, Slopes

MEMORY = 100.0  # samples over which innovations are compared with what is believed of them


class MechanicalKalman(AbstractLaw):
    """The belief, driven by `(u, y)`: sampled, a prediction over the interval with u held,
    and an update by the positions at its end; in continuous time Riccati's equation, for
    noise of these deviations on samples `interval` (s) apart. The first velocities are
    `initial`, zero by default.

    Where samples may be missing `trust` is 0 over an interval of which one is, and `lost`
    is what the square of the length of u is to be multiplied by for the variance of a u
    that is held in place of a missing one."""

    motion: Motion
    deviations: Deviations
    initial: Float[Array, " n"] | None
    interval: Float[Array, ""] | None
    trust: Float[Array, ""] | float = 1.0
    lost: Float[Array, ""] | None = None

    def start(self, y: Float[Array, " n"]) -> MechanicalBelief:
        """The first belief, at the first y."""
        of, dtype = self.deviations, y.dtype
        velocity = jnp.zeros_like(y) if self.initial is None else self.initial
        mean = jnp.concatenate([y, velocity, self.motion.nominal(dtype)])
        d = jnp.concatenate([of.output, of.velocity, of.parameters]) ** 2
        one = jnp.eye(d.shape[0], dtype=dtype)
        factors = packed(one, d.astype(dtype))
        return MechanicalBelief(mean.astype(dtype), factors, jnp.zeros((), dtype))

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        (u, y0), (_, y1) = v0, v1
        dtype, n = y1.dtype, y1.shape[0]
        h = jnp.asarray(coefficients, dtype)
        U, d = unpacked(X.factors), X.factors.pivots
        x, parameters = X.mean[: 2 * n], X.mean[2 * n :]
        velocity = self._about(x[n:], U[n : 2 * n], d, (y1 - y0) / h, h)
        about = jnp.concatenate([x[:n], velocity])
        rate = lambda _, x: self.motion.rate(x, parameters, u)
        ahead = runge_kutta(rate, 0.0, about, h)
        middle = about + 0.5 * h * rate(0.0, about)
        F, noise = over(self.motion.slopes(middle, parameters, u), h)
        ahead = ahead + F[:, n : 2 * n] @ (x[n:] - velocity)
        mean = jnp.concatenate([ahead, parameters])
        U, d = self._propagated(U, d, F, noise, self.variances(u), h)
        misfit = X.misfit
        for j in range(n):
            error, variance = y1[j] - mean[j], self.deviations.output[j] ** 2
            U, d, gain, total = updated(U, d, self.trust * U[j], variance)
            mean = mean + gain * error
            misfit = misfit + self.trust * (error**2 / total - X.misfit) / (n * MEMORY)
        return MechanicalBelief(mean, packed(U, d), misfit)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return flow(self, X, *v)

    def variances(self, u: Float[Array, " m"]) -> Float[Array, " w"]:
        """Those of what is noise in the accelerations: of u, and of forces not in it."""
        found = self.deviations.input**2
        if self.lost is not None:
            found = found + self.lost * jnp.sum(u * u)
        force = self.deviations.force
        return found if force is None else jnp.concatenate([found, force**2])

    def _propagated(
        self,
        U: Float[Array, "N N"],
        d: Float[Array, " N"],
        F: Float[Array, "d N"],
        noise: Float[Array, "d w"],
        variances: Float[Array, " w"],
        h: Float[Array, ""],
    ) -> tuple[Float[Array, "N N"], Float[Array, " N"]]:
        """The factors at the end of an interval."""
        m, drift = F.shape[0], self.deviations.drift
        if drift is None:
            # Parameters that do not move keep their own factors.
            W = jnp.concatenate([F[:, :m] @ U[:m, :m], noise], axis=1)
            moved, pivots = propagated(W, jnp.concatenate([d[:m], variances]))
            above = jnp.concatenate([moved, F @ U[:, m:]], axis=1)
            return jnp.concatenate([above, U[m:]]), jnp.concatenate([pivots, d[m:]])
        (k,), (_, w) = drift.shape, noise.shape
        still = jnp.zeros((m, k), U.dtype), jnp.zeros((k, w), U.dtype)
        above = jnp.concatenate([F @ U, noise, still[0]], axis=1)
        below = jnp.concatenate([U[m:], still[1], jnp.eye(k, dtype=U.dtype)], axis=1)
        weights = jnp.concatenate([d, variances, h * drift**2])
        return propagated(jnp.concatenate([above, below]), weights)

    def _about(
        self,
        mean: Float[Array, " n"],
        U: Float[Array, "n N"],
        d: Float[Array, " N"],
        seen: Float[Array, " n"],
        h: Float[Array, ""],
    ) -> Float[Array, " n"]:
        """The velocities about which the motion is linear over an interval: those of the
        mean, or where they are known less well than that the difference of both positions,
        which is `seen`. From nothing known the mean is only the guess."""
        variances = self.trust * h * h * jnp.sum(U * U * d, axis=1)
        return jnp.where(variances > 2.0 * self.deviations.output**2, seen, mean)


def over(
    slopes: Slopes, h: Float[Array, ""]
) -> tuple[Float[Array, "d N"], Float[Array, "d w"]]:
    """What positions and velocities after an interval of `h` seconds are, by what they were
    and the parameters, and by noise that is held over it, to the second order in h: `1 + h
    A + h^2 A^2/2`, A at its middle."""
    one = jnp.eye(slopes.position.shape[0], dtype=slopes.position.dtype)
    half = 0.5 * h * h
    C = h * (one + 0.5 * h * slopes.velocity)
    by_q = one + half * slopes.position, C @ slopes.position
    by_v = C, one + C @ slopes.velocity + half * slopes.position
    by_parameters = half * slopes.parameters, C @ slopes.parameters
    F = [jnp.concatenate(each) for each in (by_q, by_v, by_parameters)]
    noise = jnp.concatenate([half * slopes.noise, C @ slopes.noise])
    return jnp.concatenate(F, axis=1), noise
