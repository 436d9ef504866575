"""The synchronous reluctance motor."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import real
from .._typing import RealArray
from ._machine import AbstractMachine, Inductance, direction, no_load
from ._modelled import AbstractModelledPlant, Scalar, Span, parameter

__all__ = ["SynchronousReluctance"]

CURRENT, VOLTAGE, FLUX = Span(-25.0, 25.0, "A"), Span(-300.0, 300.0, "V"), Span(-1, 1, "Wb")


class SynchronousReluctance(AbstractMachine, AbstractModelledPlant):
    """A motor whose rotor has no magnets, but iron of which one direction conducts flux
    better: `phi' = u - R i`, `(phi - Ld i)'(phi - Lq i) = 0`, in the stationary frame.
    Input u the stator voltage (V), output the stator current (A), hidden part the stator
    flux (Wb), each of shape `(2,)`. Where the rotor is does not enter the relation:
    [`SynchronousReluctance.active_flux`][] tells it.

    - `resistance` R (ohm), `direct_inductance` Ld, `quadrature_inductance` Lq (H),
      `pole_pairs`, `inertia` (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention.

    By default the motor of 6.7 kW, 370 V and 15.5 A of the examples of motulator, without
    saturation (https://github.com/Aalto-Electric-Drives/motulator).

    Source: Boldea, "Reluctance Synchronous Machines and Drives", 1996, ch. 3.
    """

    resistance: Scalar = parameter("of the stator", "ohm", 0.54)
    direct_inductance: Scalar = parameter("along the iron", "H", 41.5e-3)
    quadrature_inductance: Scalar = parameter("across the iron", "H", 6.2e-3)
    pole_pairs: int = eqx.field(static=True, default=2)
    inertia: Float[Array, ""] = eqx.field(converter=real, default=0.015)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    states: ClassVar = {"flux_alpha": FLUX, "flux_beta": FLUX}
    outputs: ClassVar = {"i_alpha": CURRENT, "i_beta": CURRENT}
    inputs: ClassVar = {"u_alpha": VOLTAGE, "u_beta": VOLTAGE}

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> RealArray:
        del x
        return self.flux_rate(u, y)

    def h(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        across = self.active_flux(x, y)
        return [jnp.sum((x - self.direct_inductance * y) * across)]

    def active_flux(
        self, flux: Float[Array, "*batch 2"], y: Float[Array, "*batch 2"]
    ) -> Float[Array, "*batch 2"]:
        """`phi - Lq i` (Wb), along the d axis: `(Ld - Lq) i_d` times `(cos, sin)` of the
        electrical angle, of the `flux` and the current `y`."""
        return flux - self.quadrature_inductance * y

    def inductances(self, theta: RealArray) -> Inductance:
        Ld, Lq = self.direct_inductance, self.quadrature_inductance
        mean, half = 0.5 * (Ld + Lq), 0.5 * (Ld - Lq)
        a, b = half * direction(2.0 * theta)
        return jnp.stack([jnp.stack([mean + a, b]), jnp.stack([b, mean - a])])

    def magnet(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(direction(theta))

    def flux_rate(self, u: RealArray, y: RealArray) -> RealArray:
        return u - self.resistance * y

    def detent(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(theta)
