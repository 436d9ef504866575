"""Speed control of a synchronous reluctance motor."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._kinks import clip, smaller
from .._typing import PyTree, RealArray
from ..plants import SynchronousReluctance
from ._base import AbstractController
from ._field_oriented import rotate

__all__ = ["ReluctanceDrive"]


class ReluctanceDrive(AbstractController):
    """PI speed control over the fluxes, with a constant current along the iron: it is fed a
    [`MotorFeedback`][].

    - `motor`: what the gains are computed from;
    - `reference(t)`: the mechanical speed (rad/s) to follow;
    - `direct_current` (A): along the d axis, which magnetises; `current_limit` (A): the
      largest on the q axis, at which the integral is held back; `voltage_limit` (V);
    - `flux_bandwidth`, `speed_bandwidth` (rad/s).

    `u = R i + J w psi + b (psi* - psi)` with the fluxes psi of the currents at the angle
    that it is fed, and those psi* of the wanted currents.

    Source: Boldea, "Reluctance Synchronous Machines and Drives", 1996, ch. 5.
    """

    motor: SynchronousReluctance
    reference: Callable[[Float[Array, ""]], Float[Array, ""]]
    direct_current: Float[Array, ""] = eqx.field(converter=real)
    current_limit: Float[Array, ""] = eqx.field(converter=real)
    voltage_limit: Float[Array, ""] = eqx.field(converter=real, default=1e6)
    flux_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=1000.0)
    speed_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=50.0)

    def __check_init__(self) -> None:
        positive("direct_current", self.direct_current, "A")
        positive("current_limit", self.current_limit, "A")
        positive("voltage_limit", self.voltage_limit, "V")
        positive("flux_bandwidth", self.flux_bandwidth, "rad/s")
        positive("speed_bandwidth", self.speed_bandwidth, "rad/s")

    @property
    def torque_constant(self) -> Float[Array, ""]:
        """Torque over current on the q axis (N m/A)."""
        motor = self.motor
        saliency = motor.direct_inductance - motor.quadrature_inductance
        return motor.torque_factor * motor.pole_pairs * saliency * self.direct_current

    def init(self, fed: PyTree) -> PyTree:
        return jnp.zeros_like(fed.speed)  # the integral, a torque (N m)

    def _torque(self, t, state, fed):
        b, J = self.speed_bandwidth, self.motor.inertia
        error = self.reference(t) - fed.speed
        wanted = state + b * J * error
        limit = self.current_limit * self.torque_constant
        torque = clip(wanted, -limit, limit)
        return torque, b * b * J / 4.0 * error + b * (torque - wanted)

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self._torque(t, state, fed)[1]

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        motor = self.motor
        torque, _ = self._torque(t, state, fed)
        L = jnp.stack([motor.direct_inductance, motor.quadrature_inductance])
        wanted = jnp.stack([self.direct_current, torque / self.torque_constant])
        own = rotate(-fed.angle, fed.current)
        flux, w = L * own, motor.pole_pairs * fed.speed
        turning = w * jnp.stack([-flux[1], flux[0]])
        u = motor.resistance * own + turning + self.flux_bandwidth * L * (wanted - own)
        size = jnp.sqrt(jnp.sum(u**2) + jnp.finfo(u.dtype).tiny)
        return rotate(fed.angle, u * smaller(1.0, self.voltage_limit / size))
