"""The surface-mounted permanent-magnet synchronous motor (paper, section 3.1)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real, whole
from .._module import Module
from .._typing import RealArray
from ..relations import Quadratic
from .machine import AbstractMachine, Inductance, direction, no_load

__all__ = ["PMSM", "FluxRelation"]


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


class PMSM(AbstractMachine):
    """A non-salient PMSM: input u the stator voltage (V), output the stator current (A),
    hidden part the stator flux (Wb), each of shape `(2,)`.

    - `resistance` (ohm), `inductance` (H), `magnet_flux` (Wb), `pole_pairs`, `inertia`
      (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention; 1 as the paper prints it.
      The paper's load of 3.5 N m takes 2.24 A with 3/2, and 3.36 A with 1, which is more
      than the 2.3 A of its Table 1.

    Source: paper, eqs. (sys) and (flucur).
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    magnet_flux: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    def __check_init__(self) -> None:
        positive("resistance", self.resistance, "ohm")
        positive("inductance", self.inductance, "H")
        positive("magnet_flux", self.magnet_flux, "Wb")
        positive("inertia", self.inertia, "kg m^2")
        whole("pole_pairs", self.pole_pairs)

    @classmethod
    def bmp0701f(cls, **changes: Any) -> "PMSM":
        """The motor BMP0701F of the paper's Table 1; `changes` replace or add arguments."""
        table: dict[str, Any] = dict(
            resistance=8.875,
            inductance=40.03e-3,
            magnet_flux=0.2086,
            pole_pairs=5,
            inertia=60e-6,
        )
        return cls(**(table | changes))

    def inductances(self, theta: RealArray) -> Inductance:
        return self.inductance

    def magnet(self, theta: RealArray) -> RealArray:
        return self.magnet_flux * direction(theta)

    def flux_rate(self, u: RealArray, y: RealArray) -> RealArray:
        return u - self.resistance * y

    def detent(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(theta)

    def flux_relation(self) -> FluxRelation:
        """The quadratic relation of the stator flux, for an observer."""
        return FluxRelation(self.resistance, self.inductance, self.magnet_flux)
