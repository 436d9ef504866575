"""Field-oriented control of a permanent-magnet motor, with an angle and without one."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._kinks import below, clip, larger, smaller
from .._module import Module
from .._typing import PyTree, RealArray
from ..plants import PMSM
from ._base import AbstractController

__all__ = [
    "CurrentState",
    "FieldOriented",
    "ForcedStart",
    "ForcedState",
    "MotorFeedback",
    "across",
    "rotate",
]


class MotorFeedback(Module):
    """What a motor controller is fed: `current` (A, stationary frame, shape `(2,)`), the
    electrical `angle` (rad) and the mechanical `speed` (rad/s), measured or estimated."""

    current: Float[Array, " 2"]
    angle: Float[Array, ""]
    speed: Float[Array, ""]


class CurrentState(Module):
    """The integrals of the controllers: torque (N m) and voltage (V, stationary frame)."""

    torque: Float[Array, ""]
    voltage: Float[Array, " 2"]


def rotate(angle: Float[Array, ""], x: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """`x`, shape `(2,)`, turned by `angle` (rad): from the rotor's frame to the stationary
    one.
    """
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * x[0] - s * x[1], s * x[0] + c * x[1]])


def across(angle: Float[Array, ""], x: Float[Array, ""]) -> Float[Array, " 2"]:
    """x on the torque axis of a rotor at `angle` (rad), in the stationary frame."""
    return x * jnp.stack([-jnp.sin(angle), jnp.cos(angle)])


class FieldOriented(AbstractController):
    """PI speed control over PI current control, all of the current on the torque axis.

    - `motor`: what the gains are computed from;
    - `reference(t)`: the mechanical speed (rad/s) to follow;
    - `current_limit` (A, amplitude), `voltage_limit` (V, amplitude): the integrals are
      held back by what a limit cuts off (back-calculation);
    - `current_bandwidth`, `speed_bandwidth` (rad/s).

    The voltage integral lives in the stationary frame, where it turns with the rotor: the
    same law as in the rotor's frame, and a correction of the angle does not upset it.

    Source: paper, section 3.1.3; Harnefors and Nee 1998, doi:10.1109/28.658735.
    """

    motor: PMSM
    reference: Callable[[Float[Array, ""]], Float[Array, ""]]
    current_limit: Float[Array, ""] = eqx.field(converter=real)
    voltage_limit: Float[Array, ""] = eqx.field(converter=real, default=1e6)
    current_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=2000.0)
    speed_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=300.0)

    def __check_init__(self) -> None:
        positive("current_limit", self.current_limit, "A")
        positive("voltage_limit", self.voltage_limit, "V")
        positive("current_bandwidth", self.current_bandwidth, "rad/s")
        positive("speed_bandwidth", self.speed_bandwidth, "rad/s")

    @property
    def torque_constant(self) -> Float[Array, ""]:
        """Torque over current on the torque axis (N m/A)."""
        return self.motor.torque_factor * self.motor.pole_pairs * self.motor.magnet_flux

    def init(self, fed: MotorFeedback) -> CurrentState:
        return CurrentState(jnp.zeros_like(fed.speed), jnp.zeros_like(fed.current))

    def torque_current(
        self, t: Float[Array, ""], state: CurrentState, fed: MotorFeedback
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The torque current (A) and the derivative of the torque integral (N m/s)."""
        b, J = self.speed_bandwidth, self.motor.inertia
        error = self.reference(t) - fed.speed
        wanted = state.torque + b * J * error
        limit = self.current_limit * self.torque_constant
        torque = clip(wanted, -limit, limit)
        rate = b * b * J / 4.0 * error + b * (torque - wanted)
        return torque / self.torque_constant, rate

    def voltage(
        self,
        state: CurrentState,
        fed: MotorFeedback,
        current: Float[Array, " 2"],
        angle: Float[Array, ""],
        speed: Float[Array, ""],
    ) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """The voltage (V) that brings the current to `current` (A, stationary frame), in a
        frame at `angle` (rad) that turns at `speed` (rad/s, electrical), and the derivative
        of the voltage integral (V/s)."""
        b, L, R = self.current_bandwidth, self.motor.inductance, self.motor.resistance
        back_emf = across(angle, speed * self.motor.magnet_flux)
        error = current - fed.current
        wanted = b * L * error + state.voltage + back_emf
        size = jnp.sqrt(jnp.sum(wanted**2) + jnp.finfo(wanted.dtype).tiny)
        u = wanted * smaller(1.0, self.voltage_limit / size)
        turning = speed * jnp.stack([-state.voltage[1], state.voltage[0]])
        return u, b * R * error + turning + b * (u - wanted)

    def _law(self, t, state, fed):
        iq, torque_rate = self.torque_current(t, state, fed)
        current = across(fed.angle, iq)
        speed = self.motor.pole_pairs * fed.speed
        u, voltage_rate = self.voltage(state, fed, current, fed.angle, speed)
        return u, CurrentState(torque_rate, voltage_rate)

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self._law(t, state, fed)[1]

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self._law(t, state, fed)[0]


class ForcedState(Module):
    """The state of the controller it starts, and the current (A) on the flux axis."""

    inner: CurrentState
    flux_current: Float[Array, ""]


class ForcedStart(AbstractController):
    """Starts a motor whose angle is unknown, then hands over to `controller`.

    A motor without saliency shows no angle at rest. So a current of `current` (A) along a
    forced angle first aligns the rotor (`align` seconds, raised smoothly), then turns it up
    to `speed` (mechanical rad/s) with `acceleration` (rad/s^2), and `settle` seconds later
    the controller takes over with the angle and speed it is fed. The forced current leaves
    the flux axis over the next `blend` seconds.

    `current` must carry the load with a margin: the rotor lags the forced angle by
    the asin of load torque over `current` times the torque constant.
    """

    controller: FieldOriented
    current: Float[Array, ""] = eqx.field(converter=real)
    speed: Float[Array, ""] = eqx.field(converter=real)
    align: Float[Array, ""] = eqx.field(converter=real, default=0.3)
    acceleration: Float[Array, ""] = eqx.field(converter=real, default=10.0)
    settle: Float[Array, ""] = eqx.field(converter=real, default=0.2)
    blend: Float[Array, ""] = eqx.field(converter=real, default=0.1)

    def __check_init__(self) -> None:
        positive("current", self.current, "A")
        positive("speed", self.speed, "rad/s")
        positive("align", self.align, "s")
        positive("acceleration", self.acceleration, "rad/s^2")
        positive("blend", self.blend, "s")

    @property
    def handover(self) -> Float[Array, ""]:
        """When the controller takes over (s)."""
        return self.align + self.speed / self.acceleration + self.settle

    def init(self, fed: MotorFeedback) -> ForcedState:
        return ForcedState(self.controller.init(fed), jnp.zeros_like(fed.speed))

    def forced(self, t: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The forced electrical angle (rad) and speed (rad/s)."""
        n, ramp = self.controller.motor.pole_pairs, self.speed / self.acceleration
        s = clip(t - self.align, 0.0, ramp)
        cruise = larger(t - self.align - ramp, 0.0)
        turned = self.acceleration * s**2 / 2.0 + self.speed * cruise
        return n * turned, n * self.acceleration * s

    def _law(self, t, state, fed):
        control, inner = self.controller, state.inner
        closed = ~below(t, self.handover)
        angle, speed = self.forced(t)
        rise = smaller(2.0 * t / self.align, 1.0)
        current = rotate(angle, jnp.stack([self.current * rise, 0.0 * rise]))
        iq, torque_rate = control.torque_current(t, inner, fed)
        own = rotate(fed.angle, jnp.stack([state.flux_current, iq]))
        angle = jnp.where(closed, fed.angle, angle)
        speed = jnp.where(closed, control.motor.pole_pairs * fed.speed, speed)
        current = jnp.where(closed, own, current)
        u, voltage_rate = control.voltage(inner, fed, current, angle, speed)
        # Until the handover the integrals follow the forced current as the rotor sees it,
        # so that the controller takes over with the torque that there is.
        seen, b = rotate(-fed.angle, fed.current), control.speed_bandwidth
        follow = b * (control.torque_constant * seen[1] - inner.torque)
        torque_rate = jnp.where(closed, torque_rate, follow)
        fade = -state.flux_current / self.blend
        flux_rate = jnp.where(closed, fade, b * (seen[0] - state.flux_current))
        return u, ForcedState(CurrentState(torque_rate, voltage_rate), flux_rate)

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self._law(t, state, fed)[1]

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self._law(t, state, fed)[0]
