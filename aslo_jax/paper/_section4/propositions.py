"""Propositions 4 and 5 of the paper, line by line, as observers."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._checks import real
from ..._filters import LowPass
from ..._realise import Pass
from ..._typing import PyTree
from ...observers import AbstractObserver, Estimate
from ...plants import AbstractMechanicalSystem, BallBeam, RoboticLeg


def _estimate(value: Float[Array, " n"]) -> Estimate:
    return Estimate(value, jnp.ones_like(value[0]), jnp.asarray(False))


class Proposition4(AbstractObserver):
    """P1 of Prop. 4, the velocities of the robotic leg, with lambda = `rate` (rad/s), every
    filter from zero.

    - `denominator`: `"F[z1]"` as printed, or `"F[1/z1]"`, which the proof of appendix D
      gives, of w1;
    - `sign`: of `F[u2]/(m2 lambda)` in q3', +1 as printed or -1.

    The filter of pF[q2] starts at q2(0): from zero the estimate of q2' begins as q2(0)/t,
    and w4, which is driven by its square, is unbounded.

    Source: paper, Prop. 4, eqs. (zrl) and (dynrl).
    """

    system: RoboticLeg
    rate: Float[Array, ""] = eqx.field(converter=real)
    denominator: str = eqx.field(static=True, default="F[z1]")
    sign: int = eqx.field(static=True, default=1)

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " 3"]) -> Estimate:
        F, lam = F.using(LowPass(self.rate), "paper"), self.rate
        m1, m2 = self.system.m1, self.system.m2
        z1, z2 = y[0] ** 2, u[1] / (m1 * y[0] ** 2)
        inverse = F(1.0 / z1, "F[1/z1]")
        w1 = F.p(y[1], "q2", settled=True) + F(z1 * z2 * inverse, "w1") / lam
        w2 = F(u[1], "w2") / (m2 * lam)
        w3 = F.p(y[2], "q3")
        filtered = F(z1, "F[z1]") if self.denominator == "F[z1]" else inverse
        started = filtered > 0  # at t = 0 there is no estimate yet
        rate2 = jnp.where(started, w1 / (z1 * jnp.where(started, filtered, 1.0)), 0.0)
        w4 = F(y[0] * rate2**2 + u[0] / m1, "w4") / lam
        return _estimate(jnp.stack([F.p(y[0], "q1") + w4, rate2, self.sign * w2 + w3]))


class Proposition5(AbstractObserver):
    """P1 of Prop. 5, the velocities of the ball and beam, with lambda = `rate` (rad/s),
    every filter from zero but that of pF[q2], as in [`Proposition4`][].

    Source: paper, Prop. 5.
    """

    system: BallBeam
    rate: Float[Array, ""] = eqx.field(converter=real)

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " 2"]) -> Estimate:
        F, lam = F.using(LowPass(self.rate), "paper"), self.rate
        g = self.system.gravity
        z2 = self.system.length**2 + y[0] ** 2
        z1 = (-g * y[0] * jnp.cos(y[1]) + u[0]) / z2
        w1 = F(1.0 / z2, "w1")
        w2 = F(w1 * z1 * z2, "w2")
        started = w1 > 0  # at t = 0 there is no estimate yet
        top = w2 / lam + F.p(y[1], "q2", settled=True)
        rate2 = jnp.where(started, top / (jnp.where(started, w1, 1.0) * z2), 0.0)
        drive = y[0] * rate2**2 - g * jnp.sin(y[1])
        rate1 = F.p(y[0], "q1") + F(drive, "q1.acceleration") / lam
        return _estimate(jnp.stack([rate1, rate2]))


class VelocityAsymptotic(AbstractObserver[dict[str, Estimate]]):
    """P2 of Props 4 and 5: `v' = a(q, v_algebraic, u) - gain (v - v_algebraic)` from zero,
    the model's acceleration a at the algebraic velocities, for each of `gains` (rad/s),
    shape `(k,)`: a dictionary of the algebraic estimate, `ASLO`, shape `(n,)`, and these,
    `A-ASLO`, shape `(k, n)`.

    The library's own A-ASLO is one of the momenta ([`velocity_observer`][]).
    """

    observer: AbstractObserver
    system: AbstractMechanicalSystem
    gains: Float[Array, " k"] = eqx.field(converter=real)

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> dict[str, Estimate]:
        found = self.observer.equations(F.scope("algebraic"), u, y)
        along = self.system.acceleration(y, found.value, u)

        def rate(v):
            return along - self.gains[:, None] * (v - found.value)

        v = F.state("velocity", jnp.zeros((self.gains.size, y.size), y.dtype), rate)
        each = lambda x: jnp.broadcast_to(x, self.gains.shape)
        smoothed = Estimate(v, each(found.certificate), each(found.coasting))
        return {"ASLO": found, "A-ASLO": smoothed}
