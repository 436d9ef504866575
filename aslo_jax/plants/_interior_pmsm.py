"""The interior permanent-magnet synchronous motor (paper, O8)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._module import Module
from .._relations import Quadratic
from .._small import safe_rsqrt
from .._typing import RealArray
from ._machine import Inductance, direction, no_load
from ._magnet import AbstractMagnetMachine


class SalientFluxRelation(Module):
    """`(phi - Ld i)'(phi - Lq i) = m (m + (Ld - Lq) i_d)`: the stator flux phi (Wb) of an
    interior PMSM from stator voltage u (V) and current i (A), all of shape `(2,)`.

    The unknown `m (Ld - Lq) i_d` is dropped, and with it the need for the magnet flux m. A
    constant i_d costs nothing; a ripple of it leaves an error linear in it and in Ld - Lq,
    of up to half their product, and much less where the filter's rate is well above the
    frequency of the ripple and not above the electrical speed: 0.06 mWb for 1 mH and 1 A at
    9 rad/s, with rates of 20 to 70 rad/s at 150 rad/s. [`SelfConsistentFluxRelation`][] has
    no such error.

    - `resistance` (ohm), `direct_inductance` Ld, `quadrature_inductance` Lq (H).

    Source: paper, O8; theory, section 2.
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    direct_inductance: Float[Array, ""] = eqx.field(converter=real)
    quadrature_inductance: Float[Array, ""] = eqx.field(converter=real)

    def __call__(self, u: Float[Array, " 2"], y: Float[Array, " 2"]) -> Quadratic:
        return self.terms(u, y, jnp.zeros_like(y[0]))

    def terms(
        self, u: Float[Array, " 2"], y: Float[Array, " 2"], product: Float[Array, ""]
    ) -> Quadratic:
        """The terms with `product`, `m (m + (Ld - Lq) i_d)` (Wb^2) up to a constant."""
        Ld, Lq = self.direct_inductance, self.quadrature_inductance
        total = Ld + Lq
        return Quadratic(
            Q=2.0 / total,
            c=y,
            d=(product - Ld * Lq * jnp.sum(y * y)) / total,
            z=u - self.resistance * y,
        )

    def active_flux(
        self, flux: Float[Array, "*batch 2"], y: Float[Array, "*batch 2"]
    ) -> Float[Array, "*batch 2"]:
        """`phi - Lq i` (Wb), which points along the d axis: `m + (Ld - Lq) i_d` times
        `(cos, sin)` of the electrical angle."""
        return flux - self.quadrature_inductance * y


class SelfConsistentFluxRelation(Module):
    """The relation of an interior PMSM with the d current seen by an estimate of the flux:
    `i_d = x_a'i/|x_a|`, `x_a = flux - Lq i`, which is within +-|i| whatever the estimate.

    For [`SelfConsistent`][]. `salient` is the relation with the d current given.
    `magnet_flux` (Wb) is needed here. Requires `m + (Ld - Lq) i_d > 0`.

    Source: theory, section 2.
    """

    salient: SalientFluxRelation
    magnet_flux: Float[Array, ""] = eqx.field(converter=real)

    def __call__(
        self, u: Float[Array, " 2"], y: Float[Array, " 2"], flux: Float[Array, " 2"]
    ) -> Quadratic:
        relation, m = self.salient, self.magnet_flux
        x = relation.active_flux(flux, y)
        direct = jnp.sum(x * y) * safe_rsqrt(jnp.sum(x * x))
        saliency = relation.direct_inductance - relation.quadrature_inductance
        return relation.terms(u, y, m * (m + saliency * direct))


class InteriorPMSM(AbstractMagnetMachine):
    """A salient PMSM: input u the stator voltage (V), output the stator current (A), hidden
    part the stator flux (Wb), each of shape `(2,)`.

    - `resistance` (ohm), `direct_inductance` Ld and `quadrature_inductance` Lq (H),
      `magnet_flux` (Wb), `pole_pairs`, `inertia` (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention.

    Source: paper, O8; `L(theta)` as printed there.
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    direct_inductance: Float[Array, ""] = eqx.field(converter=real)
    quadrature_inductance: Float[Array, ""] = eqx.field(converter=real)
    magnet_flux: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    def __check_init__(self) -> None:
        positive("direct_inductance", self.direct_inductance, "H")
        positive("quadrature_inductance", self.quadrature_inductance, "H")
        positive("magnet_flux", self.magnet_flux, "Wb")

    @classmethod
    def motulator_2200w(cls, **changes: Any) -> "InteriorPMSM":
        """The 2.2 kW, 370 V, 4.3 A, 75 Hz motor of the examples of motulator
        (https://github.com/Aalto-Electric-Drives/motulator). `changes` replace or add
        arguments."""
        table: dict[str, Any] = dict(
            resistance=3.6,
            direct_inductance=36e-3,
            quadrature_inductance=51e-3,
            magnet_flux=0.545,
            pole_pairs=3,
            inertia=0.015,
        )
        return cls(**(table | changes))

    def inductances(self, theta: RealArray) -> Inductance:
        Ld, Lq = self.direct_inductance, self.quadrature_inductance
        mean, half = 0.5 * (Ld + Lq), 0.5 * (Ld - Lq)
        a, b = half * direction(2.0 * theta)
        return jnp.stack([jnp.stack([mean + a, b]), jnp.stack([b, mean - a])])

    def detent(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(theta)

    def flux_relation(self) -> SalientFluxRelation:
        """The relation of the stator flux without the magnet flux, for an
        [`AlgebraicObserver`][]."""
        return SalientFluxRelation(
            self.resistance, self.direct_inductance, self.quadrature_inductance
        )

    def self_consistent_relation(self) -> SelfConsistentFluxRelation:
        """The relation with the d current fed back, for [`SelfConsistent`][]."""
        return SelfConsistentFluxRelation(self.flux_relation(), self.magnet_flux)
