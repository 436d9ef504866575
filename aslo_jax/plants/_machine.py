"""The generalised electrical machine (paper, O5), which the motors of this package are."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, whole
from .._module import Module
from .._relations import contract
from .._small import solve_definite
from .._typing import PyTree, RealArray
from ._base import AbstractPlant

Inductance = Float[Array, ""] | Float[Array, "n n"]


class MachineState(Module):
    """`flux` linked with each winding (Wb), shape `(n,)`; mechanical `speed` (rad/s) and
    mechanical `angle` (rad), unwrapped."""

    flux: Float[Array, " n"]
    speed: Float[Array, ""]
    angle: Float[Array, ""]


def no_load(t: Float[Array, ""]) -> Float[Array, ""]:
    """No load torque (N m), at any time."""
    return jnp.zeros_like(t)


def direction(theta: Float[Array, ""]) -> Float[Array, " 2"]:
    """`(cos theta, sin theta)` of an angle (rad)."""
    return jnp.stack([jnp.cos(theta), jnp.sin(theta)])


class AbstractMachine(AbstractPlant):
    """`phi' = G u - R y`, `phi = L(theta) y + mu(theta)` with n windings: input u the
    winding voltages (V), output y the winding currents (A), hidden part the flux linkages
    phi (Wb). theta is the electrical angle (rad), `pole_pairs` times the mechanical one.

    `J w' = torque - friction w - load(t)`. The torque is the derivative of the co-energy
    `1/2 y'L(theta) y + y'mu(theta)` along theta at constant currents, times
    `torque_factor pole_pairs`, and the detent torque. `torque_factor` is 3/2 for the
    amplitude-invariant two-phase equivalent of a three-phase machine, 1 for a machine that
    has two phases; power and stored energy carry it too.

    Source: paper, O5; Ortega, Loria, Nicklasson, Sira-Ramirez, "Passivity-based Control of
    Euler-Lagrange Systems", 1998, eqs. (9.6) to (9.8), doi:10.1007/978-1-4471-3603-3.
    """

    pole_pairs: eqx.AbstractVar[int]
    inertia: eqx.AbstractVar[Float[Array, ""]]
    friction: eqx.AbstractVar[Float[Array, ""]]
    load: eqx.AbstractVar[Callable[[Float[Array, ""]], Float[Array, ""]]]
    torque_factor: eqx.AbstractVar[Float[Array, ""]]

    def __check_init__(self) -> None:
        # Equinox calls this after the checks of the final class.
        positive("inertia", self.inertia, "kg m^2")
        whole("pole_pairs", self.pole_pairs)

    @abc.abstractmethod
    def inductances(self, theta: Float[Array, ""]) -> Inductance:
        """`L(theta)` (H), symmetric and positive definite, shape `(n, n)`; a scalar where
        it is that times the identity."""

    @abc.abstractmethod
    def magnet(self, theta: Float[Array, ""]) -> Float[Array, " n"]:
        """`mu(theta)`: what the magnets link with each winding (Wb), shape `(n,)`."""

    @abc.abstractmethod
    def flux_rate(self, u: Float[Array, " m"], y: Float[Array, " n"]) -> Float[Array, " n"]:
        """`G u - R y` (V), shape `(n,)`."""

    @abc.abstractmethod
    def detent(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        """The torque of the magnets on the iron alone (N m)."""

    def initial(self) -> PyTree:
        """At rest, angle zero, no current."""
        zero = jnp.zeros_like(self.inertia)
        return MachineState(self.magnet(zero), zero, zero)

    def torque(self, x: MachineState) -> Float[Array, ""]:
        """The torque on the rotor (N m), load and friction not included."""
        y = self.output(x)

        def coenergy(theta):
            return jnp.sum(
                y * (0.5 * _times(self.inductances(theta), y) + self.magnet(theta))
            )

        theta = self.pole_pairs * x.angle
        _, derivative = jax.jvp(coenergy, (theta,), (jnp.ones_like(theta),))
        return self.torque_factor * self.pole_pairs * derivative + self.detent(theta)

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        net = self.torque(x) - self.friction * x.speed - self.load(t)
        return MachineState(self.flux_rate(u, self.output(x)), net / self.inertia, x.speed)

    def output(self, x: PyTree) -> PyTree:
        theta = self.pole_pairs * x.angle
        L, linked = self.inductances(theta), x.flux - self.magnet(theta)
        return linked / L if L.ndim == 0 else solve_definite(L, linked)[0]

    def hidden(self, x: PyTree) -> RealArray:
        return x.flux

    def field_energy(self, x: MachineState) -> Float[Array, ""]:
        """The energy stored by the currents, `1/2 y'L(theta) y` (J)."""
        y = self.output(x)
        stored = jnp.sum(y * _times(self.inductances(self.pole_pairs * x.angle), y))
        return 0.5 * self.torque_factor * stored


def _times(L: Inductance, y: Float[Array, " n"]) -> Float[Array, " n"]:
    return L * y if L.ndim == 0 else contract(L, y)
