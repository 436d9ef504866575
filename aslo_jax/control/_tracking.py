"""Tracking controllers of mechanical systems, from measured or estimated velocities."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._kinks import clip
from .._module import Module
from .._small import solve_rows
from .._typing import PyTree, RealArray
from ..plants import AbstractMechanicalSystem, BallBeam
from ._base import AbstractController

__all__ = ["BallBeamTracking", "MechanicalFeedback", "Tracking"]


class MechanicalFeedback(Module):
    """What a tracking controller is fed: `position`, the coordinates, and `velocity`,
    measured or estimated, each of shape `(n,)`.
    """

    position: Float[Array, " n"]
    velocity: Float[Array, " n"]


def _motion(
    reference: Callable[[Float[Array, ""]], Array], t: Float[Array, ""]
) -> tuple[Array, Array, Array]:
    """What `reference` asks for at t, and its first two derivatives."""
    rate = lambda t: jax.jvp(lambda t: jnp.asarray(reference(t)), (t,), (jnp.ones_like(t),))
    (wanted, speed), (_, acceleration) = jax.jvp(rate, (t,), (jnp.ones_like(t),))
    return wanted, speed, acceleration


class Tracking(AbstractController):
    """Partial feedback linearisation: as many coordinates as there are inputs follow
    `reference`, `e'' + 2 w e' + w^2 e = 0`, whatever the others do.

    - `system`: the plant, with the parameters that the controller believes;
    - `reference(t)`: the wanted coordinates at t (s), shape `(m,)`, twice differentiable;
    - `tracked`: which coordinates they are, counted from 0; their accelerations must be
      independent in the inputs;
    - `bandwidth` w (rad/s), shape `()` or `(m,)`.

    Source: Spong 1994, doi:10.1109/IROS.1994.407375.
    """

    system: AbstractMechanicalSystem
    reference: Callable[[Float[Array, ""]], Float[Array, " m"]]
    tracked: tuple[int, ...] = eqx.field(static=True)
    bandwidth: Float[Array, "*m"] = eqx.field(converter=real, default=5.0)

    def __check_init__(self) -> None:
        positive("bandwidth", self.bandwidth, "rad/s")

    def init(self, fed: MechanicalFeedback) -> PyTree:
        del fed

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del t, state, fed

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del state
        return self.force(fed, *_motion(self.reference, t))

    def force(
        self,
        fed: MechanicalFeedback,
        wanted: Float[Array, " m"],
        speed: Float[Array, " m"],
        acceleration: Float[Array, " m"],
    ) -> Float[Array, " m"]:
        """The input that makes the tracked coordinates approach `wanted`, which moves with
        `speed` and `acceleration`."""
        w, tracked = self.bandwidth, jnp.asarray(self.tracked)
        error = wanted - fed.position[tracked]
        error_rate = speed - fed.velocity[tracked]
        target = acceleration + 2.0 * w * error_rate + w * w * error

        def accelerate(u):
            return self.system.acceleration(fed.position, fed.velocity, u)[tracked]

        zero = self.system.no_input(fed.position)
        effect = jax.jacfwd(accelerate)(zero)
        size = jnp.max(jnp.abs(effect))
        return solve_rows(effect / size, (target - accelerate(zero)) / size)[0]


class BallBeamTracking(AbstractController):
    """The ball follows `reference(t)` (m): the beam is tilted to where gravity and the
    centrifugal force accelerate the ball as wanted, `e'' + 2 w e' + w^2 e = 0`, within
    `tilt`.

    - `system`: the plant, with the parameters that the controller believes;
    - `bandwidth` w (rad/s) of the ball, `beam_bandwidth` (rad/s) of the beam, which should
      be several times faster;
    - `tilt` (rad): the largest angle asked for.
    """

    system: BallBeam
    reference: Callable[[Float[Array, ""]], Float[Array, ""]]
    bandwidth: Float[Array, ""] = eqx.field(converter=real, default=1.5)
    beam_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=12.0)
    tilt: Float[Array, ""] = eqx.field(converter=real, default=0.5)

    def __check_init__(self) -> None:
        positive("bandwidth", self.bandwidth, "rad/s")
        positive("beam_bandwidth", self.beam_bandwidth, "rad/s")
        positive("tilt", self.tilt, "rad")

    def init(self, fed: MechanicalFeedback) -> PyTree:
        del fed

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del t, state, fed

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del state
        wanted, speed, acceleration = _motion(self.reference, t)
        w = self.bandwidth
        q, velocity = fed.position, fed.velocity
        target = acceleration + 2.0 * w * (speed - velocity[0]) + w * w * (wanted - q[0])
        sine = (q[0] * velocity[1] ** 2 - target) / self.system.gravity
        limit = jnp.sin(self.tilt)
        angle = jnp.arcsin(clip(sine, -limit, limit))[None]
        beam = Tracking(self.system, lambda t: angle, (1,), self.beam_bandwidth)
        return beam.force(fed, angle, jnp.zeros_like(angle), jnp.zeros_like(angle))
