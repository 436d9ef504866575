"""Plants whose signals are given functions of time: test motions in closed form."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...plants import BearingState, MagneticBearing
from ...plants._base import AbstractPlant
from ...plants._machine import AbstractMachine

Signal = Callable[[Float[Array, ""]], Float[Array, "*n"]]


class PrescribedMachine(AbstractPlant):
    """A machine whose mechanical angle (rad) and winding currents (A) are functions of time
    (s), whatever the load that this takes. The state is the time; the input that belongs to
    it is `voltage`, one for each winding."""

    machine: AbstractMachine
    angle: Signal
    current: Signal

    def initial(self):
        return jnp.zeros_like(self.machine.inertia)

    def vector_field(self, t, x, u):
        del t, u
        return jnp.ones_like(x)

    def output(self, x):
        return self.current(x)

    def hidden(self, x):
        theta, y = self.machine.pole_pairs * self.angle(x), self.current(x)
        L = self.machine.inductances(theta)
        return (L * y if L.ndim == 0 else L @ y) + self.machine.magnet(theta)

    def voltage(self, t: Float[Array, ""]) -> Float[Array, " n"]:
        """The voltage of each winding (V)."""
        y = self.current(t)
        return _rate(self.hidden, t) - self.machine.flux_rate(jnp.zeros_like(y), y)


class PrescribedBearing(AbstractPlant):
    """A magnetic bearing whose position (m) and common square of the fluxes (Wb^2) are
    functions of time (s); the fluxes differ by the force that the motion takes. The state
    is the time; the input that belongs to it is `voltage`."""

    bearing: MagneticBearing
    position: Signal
    common: Signal

    def initial(self):
        return jnp.zeros_like(self.bearing.mass)

    def vector_field(self, t, x, u):
        del t, u
        return jnp.ones_like(x)

    def state(self, t: Float[Array, ""]) -> BearingState:
        """Fluxes (Wb), position (m) and velocity (m/s)."""
        return BearingState(self.flux(t), self.position(t), self.velocity(t))

    def velocity(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Of the body (m/s)."""
        return _rate(self.position, t)

    def flux(self, t: Float[Array, ""]) -> Float[Array, " 2"]:
        """Of the coils (Wb)."""
        force = self.bearing.mass * _rate(self.velocity, t)
        half = 0.5 * self.bearing.force_constant * force
        return jnp.sqrt(self.common(t) + jnp.stack([half, -half]))

    def output(self, x):
        return self.bearing.output(self.state(x))

    def hidden(self, x):
        return self.bearing.hidden(self.state(x))

    def voltage(self, t: Float[Array, ""]) -> Float[Array, " 2"]:
        """Of the coils (V)."""
        return _rate(self.flux, t) + self.bearing.resistance * self.output(t)


def _rate(signal: Signal, t: Float[Array, ""]) -> Float[Array, "*n"]:
    return jax.jvp(signal, (t,), (jnp.ones_like(t),))[1]
