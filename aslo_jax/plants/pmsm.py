"""The surface-mounted permanent-magnet synchronous motor (paper, section 3.1)."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from ..relations import Quadratic
from .base import AbstractPlant


class FluxRelation(eqx.Module):
    """`|phi - L i|^2 = m^2`: the stator flux phi (Wb) from stator voltage u (V) and stator
    current i (A), all of shape `(2,)`, in the stationary amplitude-invariant frame.

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
            Q=jnp.eye(2, dtype=L.dtype) / L,
            c=y,
            d=0.5 * (m * m / L - L * jnp.sum(y * y)),
            z=u - self.resistance * y,
        )


class PMSMState(eqx.Module):
    """`flux` of the stator (Wb), shape `(2,)`; mechanical `speed` (rad/s) and mechanical
    `angle` (rad), unwrapped."""

    flux: Float[Array, " 2"]
    speed: Float[Array, ""]
    angle: Float[Array, ""]


def _no_load(t: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.zeros_like(t)


class PMSM(AbstractPlant):
    """A non-salient PMSM: input u the stator voltage (V), output the stator current (A),
    hidden part the stator flux (Wb), each of shape `(2,)`.

    - `resistance` (ohm), `inductance` (H), `magnet_flux` (Wb), `pole_pairs`, `inertia`
      (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention; 1 as the paper prints it.

    Source: paper, eqs. (sys) and (flucur).
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    magnet_flux: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = _no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    def __check_init__(self):
        positive("resistance", self.resistance, "ohm")
        positive("inductance", self.inductance, "H")
        positive("magnet_flux", self.magnet_flux, "Wb")
        positive("inertia", self.inertia, "kg m^2")
        if self.pole_pairs < 1:
            raise ValueError(
                f"Argument `pole_pairs` must be at least 1, but got {self.pole_pairs}."
            )

    def initial(self):
        """At rest, angle zero, no current."""
        zero = jnp.zeros_like(self.magnet_flux)
        return PMSMState(self._magnet(zero), zero, zero)

    def _magnet(self, angle: Float[Array, ""]) -> Float[Array, " 2"]:
        theta = self.pole_pairs * angle
        return self.magnet_flux * jnp.stack([jnp.cos(theta), jnp.sin(theta)])

    def vector_field(self, t, x, u):
        i = self.output(x)
        cross = x.flux[0] * i[1] - x.flux[1] * i[0]
        torque = self.torque_factor * self.pole_pairs * cross
        acceleration = (torque - self.friction * x.speed - self.load(t)) / self.inertia
        return PMSMState(u - self.resistance * i, acceleration, x.speed)

    def output(self, x):
        return (x.flux - self._magnet(x.angle)) / self.inductance

    def hidden(self, x):
        return x.flux

    def flux_relation(self) -> FluxRelation:
        """The quadratic relation of the stator flux, for an observer."""
        return FluxRelation(self.resistance, self.inductance, self.magnet_flux)
