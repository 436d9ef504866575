"""Machines with a magnet in the rotor: what those without saliency share, and all."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._module import Module
from .._relations import Quadratic
from .._typing import RealArray
from ._machine import AbstractMachine, Inductance, direction


class FluxRelation(Module):
    """`|phi - L i|^2 = m^2`: the stator flux phi (Wb) from stator voltage u (V) and stator
    current i (A), all of shape `(2,)`, in the stationary amplitude-invariant frame. Of any
    motor with round magnets and no saliency: PMSM, two-phase stepper.

    - `resistance` (ohm), `inductance` (H);
    - `magnet_flux` (Wb): not needed, since a constant drops out; it enters only the
      transient of the paper's start.

    Source: paper, Prop. 2, z1 to z3; theory, section 2.
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    magnet_flux: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __call__(self, u: Float[Array, " 2"], y: Float[Array, " 2"]) -> Quadratic:
        L, m = self.inductance, self.magnet_flux
        return Quadratic(
            Q=1.0 / L,
            c=y,
            d=0.5 * (m * m / L - L * jnp.sum(y * y)),
            z=u - self.resistance * y,
        )


class AbstractMagnetMachine(AbstractMachine):
    """Two phases of a stator around a magnet that turns."""

    resistance: eqx.AbstractVar[Float[Array, ""]]
    magnet_flux: eqx.AbstractVar[Float[Array, ""]]

    def __check_init__(self) -> None:
        positive("resistance", self.resistance, "ohm")

    def magnet(self, theta: RealArray) -> RealArray:
        return self.magnet_flux * direction(theta)

    def flux_rate(self, u: RealArray, y: RealArray) -> RealArray:
        return u - self.resistance * y


class AbstractRoundMachine(AbstractMagnetMachine):
    """One whose inductance is that of every direction."""

    inductance: eqx.AbstractVar[Float[Array, ""]]

    def __check_init__(self) -> None:
        positive("inductance", self.inductance, "H")

    def inductances(self, theta: RealArray) -> Inductance:
        return self.inductance

    def flux_relation(self) -> FluxRelation:
        """The quadratic relation of the stator flux, for an observer."""
        return FluxRelation(self.resistance, self.inductance, self.magnet_flux)
