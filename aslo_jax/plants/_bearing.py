"""The one-axis active magnetic bearing with two opposed coils."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real, positive, real
from .._kinks import kinked
from .._module import Module
from .._relations import Quadratic
from .._small import safe_reciprocal
from .._typing import PyTree, RealArray
from ._base import AbstractPlant
from ._machine import no_load

__all__ = ["BearingFluxRelation", "BearingState", "MagneticBearing"]


class BearingFluxRelation(Module):
    """`i1 psi2 + i2 psi1 = (4 g/k) psi1 psi2`: the fluxes (Wb) of two opposed coils from
    their voltages (V) and currents (A), all of shape `(2,)`, wherever the body is.

    - `resistance` (ohm) of both coils or of each, shape `()` or `(2,)`; `gap` g (m) on each
      side of the centred body; `force_constant` k = mu0 N^2 A (H m) of the N turns and the
      area A of a coil; `mass` (kg) of the body.

    With the fluxes known, so is all else: [`position`][] and [`acceleration`][].

    Source: theory, section 2.
    """

    resistance: Float[Array, "*coils"] = eqx.field(converter=real)
    gap: Float[Array, ""] = eqx.field(converter=real)
    force_constant: Float[Array, ""] = eqx.field(converter=real)
    mass: Float[Array, ""] = eqx.field(converter=real)

    def __call__(self, u: Float[Array, " 2"], y: Float[Array, " 2"]) -> Quadratic:
        exchange = jnp.asarray([[0.0, 1.0], [1.0, 0.0]], self.gap.dtype)
        return Quadratic(
            Q=exchange * (4.0 * self.gap / self.force_constant),
            c=y[::-1],
            d=jnp.zeros_like(y[0]),
            z=u - self.resistance * y,
        )

    def position(self, flux: Float[Array, " 2"], y: Float[Array, " 2"]) -> Float[Array, ""]:
        """The position (m), positive towards coil 1, from the fluxes in the sense of least
        squares, and within the air gap."""
        k, g = self.force_constant, self.gap
        side = 0.5 * k * y - g * flux  # minus and plus psi_j q
        numerator = flux[1] * side[1] - flux[0] * side[0]
        return jnp.clip(numerator * safe_reciprocal(jnp.sum(flux * flux)), -g, g)

    def acceleration(self, flux: Float[Array, " 2"]) -> Float[Array, ""]:
        """`(psi1^2 - psi2^2)/(k m)` (m/s^2): no force but that of the coils."""
        squares = flux * flux
        return (squares[0] - squares[1]) / (self.force_constant * self.mass)


class BearingState(Module):
    """`flux` of the coils (Wb), shape `(2,)`; `position` (m) and `velocity` (m/s) of the
    body, positive towards coil 1."""

    flux: Float[Array, " 2"]
    position: Float[Array, ""]
    velocity: Float[Array, ""]


class MagneticBearing(AbstractPlant):
    """One axis of a magnetic bearing, voltage fed: `psi_j' = u_j - R_j i_j`,
    `i1 = (2/k)(g - q) psi1`, `i2 = (2/k)(g + q) psi2`, `m q'' = (psi1^2 - psi2^2)/k +
    force(t) + support`. Input the coil voltages (V), output the coil currents (A), hidden
    part `(psi1, psi2, q, q')`. Unstable without a controller.

    - `resistance` (ohm) of both coils or of each, shape `()` or `(2,)`; `gap` g (m);
      `force_constant` k = mu0 N^2 A (H m); `mass` m (kg);
    - `force(t)`: an outer force (N) at time t (s), of which the observer knows nothing;
    - `bias`: the current (A) of both coils in the default initial state;
    - `touchdown`: the clearance (m) of a touch-down bearing, by default none. A body that
      is further out is held by a spring `touchdown_stiffness` (N/m) and a damper
      `touchdown_damping` (N s/m) side by side, which push and never pull; the observer
      knows nothing of that force either.

    Source: theory, section 2; Schweitzer, Maslen, "Magnetic Bearings", 2009,
    doi:10.1007/978-3-642-00497-1.
    """

    resistance: Float[Array, "*coils"] = eqx.field(converter=real)
    gap: Float[Array, ""] = eqx.field(converter=real)
    force_constant: Float[Array, ""] = eqx.field(converter=real)
    mass: Float[Array, ""] = eqx.field(converter=real)
    force: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    bias: Float[Array, ""] = eqx.field(converter=real, default=1.0)
    touchdown: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)
    touchdown_stiffness: Float[Array, ""] = eqx.field(converter=real, default=5e6)
    touchdown_damping: Float[Array, ""] = eqx.field(converter=real, default=1e3)

    def __check_init__(self) -> None:
        positive("resistance", self.resistance, "ohm")
        positive("gap", self.gap, "m")
        positive("force_constant", self.force_constant, "H m")
        positive("mass", self.mass, "kg")
        positive("touchdown_stiffness", self.touchdown_stiffness, "N/m")
        positive("touchdown_damping", self.touchdown_damping, "N s/m")
        if self.touchdown is not None:
            positive("touchdown", self.touchdown, "m")

    @classmethod
    def laboratory(cls, **changes: Any) -> "MagneticBearing":
        """Round numbers of a small laboratory rig, of no one in particular: 200 turns on
        4 cm^2, gaps of 0.5 mm, 1 kg. `changes` replace or add arguments."""
        force_constant = 4e-7 * jnp.pi * 200**2 * 4e-4
        table: dict[str, Any] = dict(
            resistance=2.0, gap=0.5e-3, force_constant=force_constant, mass=1.0
        )
        return cls(**(table | changes))

    def initial(self) -> PyTree:
        """Centred and at rest, with the current `bias` (A) in both coils."""
        zero = jnp.zeros_like(self.gap)
        flux = 0.5 * self.force_constant * self.bias / self.gap
        return BearingState(jnp.stack([flux, flux]), zero, zero)

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        outer = self.force(t) + self.support(x)
        acceleration = self.flux_relation().acceleration(x.flux) + outer / self.mass
        rate = u - self.resistance * self.output(x)
        return BearingState(rate, x.velocity, acceleration)

    def support(self, x: BearingState) -> Float[Array, ""]:
        """The force (N) of the touch-down bearing, zero within its clearance."""
        if self.touchdown is None:
            return jnp.zeros_like(x.position)
        side = jnp.sign(x.position)
        depth = jnp.abs(x.position) - self.touchdown
        push = self.touchdown_stiffness * depth + self.touchdown_damping * side * x.velocity
        return -side * _pushed(depth, push)

    def output(self, x: PyTree) -> PyTree:
        gaps = jnp.stack([self.gap - x.position, self.gap + x.position])
        return 2.0 * gaps * x.flux / self.force_constant

    def hidden(self, x: PyTree) -> RealArray:
        return jnp.concatenate([x.flux, jnp.stack([x.position, x.velocity])])

    def energy(self, x: BearingState) -> Float[Array, ""]:
        """Of the field and of the motion (J)."""
        field = 0.5 * jnp.sum(self.output(x) * x.flux)
        return field + 0.5 * self.mass * x.velocity**2

    def flux_relation(self) -> BearingFluxRelation:
        """The quadratic relation of the fluxes, for an observer."""
        return BearingFluxRelation(
            self.resistance, self.gap, self.force_constant, self.mass
        )


@kinked
def _pushed(depth, push):
    return jnp.where(depth > 0, jnp.maximum(push, 0.0), 0.0)
