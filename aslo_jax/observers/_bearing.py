"""The self-sensing magnetic bearing: fluxes, position and velocity from coil currents."""

import equinox as eqx
import jax.numpy as jnp

from .._completions import Repeat
from .._filters import LowPass
from .._guard import Guard
from .._realise import Pass
from .._relations import Rate, Row
from .._typing import PyTree
from ..plants import BearingFluxRelation
from ._algebraic import AlgebraicObserver
from ._base import AbstractObserver, Estimate
from ._lifted import Lifted

__all__ = ["BearingObserver"]


class BearingObserver(AbstractObserver):
    """Fluxes (Wb), position (m) and velocity (m/s) of a one-axis magnetic bearing from the
    voltages and currents of its coils, without a position sensor. The estimate is
    `(psi1, psi2, q, q')`, the hidden part of [`MagneticBearing`][].

    - `flux`: the guarded observer of the fluxes, with a [`BearingFluxRelation`][]; use
      `LeastSquares`, since the determinant of `Repeat` changes sign in motion, or a
      [`Lifted`][];
    - `filter`: of the velocity, its rate in rad/s;
    - `guard`: of the velocity; `None` returns the raw solution.

    The position follows from the fluxes at once. The velocity is that of a rate relation
    `q' = s'` with the estimated position for s, which means nothing before the fluxes are
    certified. So the relation is multiplied by the weight `w = F[trust]^2` of the flux
    observer's trust, `w q' = (w q)' - w' q`: zero up to the first certified instant, exact
    from there on, and fading out while the fluxes coast. An outer force is not known to
    the observer; it leaves an error of `force/(mass rate)` in the velocity.

    The certificate is the smaller one of fluxes and velocity, and the estimate coasts if
    either does.

    Source: theory, section 2 (rate relation with a weight, magnetic bearing).

    **Raises:** `ValueError` for a `flux` observer of another relation, or without a guard.
    """

    flux: AlgebraicObserver | Lifted
    filter: LowPass
    guard: Guard | None = eqx.field(default_factory=Guard)

    def __check_init__(self) -> None:
        if not isinstance(self.flux.relation, BearingFluxRelation):
            raise ValueError(
                "Argument `flux` must have a `BearingFluxRelation`, but got "
                f"{type(self.flux.relation).__name__}; use `bearing.flux_relation()`."
            )

        if self.flux.guard is None:
            raise ValueError(
                "Argument `flux` must have a guard, but it has none; the velocity follows "
                "the position from its first certified instant on."
            )

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        relation, guard = self.flux.relation, self.flux.guard
        assert isinstance(relation, BearingFluxRelation) and guard is not None
        flux = self.flux(F.scope("flux"), u, y)
        q = relation.position(flux.value, y)
        # As for the guard's memory: rounding has become small where trust begins.
        trust = guard.trust(flux.certificate, widening=1e6)
        if isinstance(self.flux, Lifted):  # whose certificate is hardly above its threshold
            trust = trust / guard.trust(jnp.ones_like(trust), widening=1e6)
        trust = F.trust * trust
        F = F.using(self.filter, "exact").scope("velocity")
        e, toward = F.hidden(F.inject(trust), "weight"), F.inject(trust)
        w, w_rate = e * e, 2.0 * e * F.filter.flow(e, toward)
        z = relation.acceleration(flux.value)[None]
        terms = Rate(c=w[None], s=w * q, z=z, d=-w_rate * q)
        row = terms.row(F)
        # Measured against a settled weight, so that it tells of a weight that is small.
        whole = F.filter.equilibrium(1.0) ** 2
        row = Row(row.r, row.b, row.z, None, whole * jnp.ones_like(row.r))
        v, certificate = Repeat()(F, row)
        coasting = flux.coasting
        if self.guard is not None:
            start = jnp.zeros_like(v)
            v, uncertain = self.guard(F.scope("guard"), v, certificate, terms, start)
            coasting = coasting | uncertain
        value = jnp.concatenate([flux.value, q[None], v])
        return Estimate(value, jnp.minimum(flux.certificate, certificate), coasting)
