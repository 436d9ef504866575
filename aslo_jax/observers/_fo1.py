"""FO1: the gradient observer of the flux by Bobtsov and others."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import known_start, optional_real, positive, real
from .._filters import AbstractFilter, AbstractLaw, check_filter
from .._realise import Pass
from .._typing import FilterStart, PyTree, RealArray
from ..plants import FluxRelation
from ._base import AbstractObserver, Estimate
from ._relaxation import relaxation

__all__ = ["FO1", "Regression"]


class Regression(NamedTuple):
    """`Y = omega'eta` for the constant `eta` (Wb), the flux less its integral from zero:
    `integral` in Wb, `omega` in Wb/s, both of shape `(2,)`; `Y` in Wb^2/s."""

    integral: Float[Array, " 2"]
    omega: Float[Array, " 2"]
    Y: Float[Array, ""]


class _Gradient(AbstractLaw):
    """`eta' = gain omega (Y - omega'eta)`; the drive is `(omega, Y)`.

    Sampled: exact for the mean omega and Y of the interval, of which `Y = omega'eta` holds
    too. Second order, and a contraction whatever the gain.
    """

    gain: Float[Array, ""]

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        omega, Y = v
        return self.gain * omega * (Y - jnp.sum(omega * X))

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.gain.dtype)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        omega, Y = 0.5 * (v0[0] + v1[0]), 0.5 * (v0[1] + v1[1])
        step = self.gain * relaxation(self.gain * jnp.sum(omega * omega), coefficients)
        return X + step * omega * (Y - jnp.sum(omega * X))


class FO1(AbstractObserver):
    """The flux of a PMSM as its integral `q` from zero and a constant `eta`, which is found
    by a gradient search on `|q + eta - L i| = const`:

        q' = u - R i,                    mu = q - L i
        Y = -pF[|mu|^2],                 omega = pF[2 mu]
        eta' = gain omega (Y - omega'eta),   flux = q + eta

    - `relation`: of its parts, `resistance` and `inductance` are used;
    - `filter`: strictly proper;
    - `gain`, in s/Wb^2: along omega the error decays at the rate `gain |omega|^2`. Any gain
      is stable when sampled;
    - `start`: `"exact"` starts the filters at their inputs' first values, so that
      `Y = omega'eta` holds for every t >= 0; `"paper"` starts them at zero, which leaves
      `lam (|eta|^2 - m^2) exp(-lam t)` of the low-pass filter, m being the magnet flux;
    - `initial`: the flux at the first instant (Wb), shape `(2,)`; zero by default.

    The estimate is the stator flux (Wb), shape `(2,)`. It has no certificate: at standstill
    omega vanishes and its error stays as it is, or drifts as a voltage offset does.

    Source: Bobtsov, Pyrkin, Ortega, Vukosavic, Stankovic, Panteley, "A robust globally
    convergent position observer for the permanent magnet synchronous motor", Automatica 61
    (2015) 47-54; paper, eq. (flux_Automatica), without its stray c; theory, section 7.
    """

    relation: FluxRelation
    filter: AbstractFilter
    gain: Float[Array, ""] = eqx.field(converter=real)
    start: FilterStart = eqx.field(static=True, default="exact")
    initial: Float[Array, " 2"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        positive("gain", self.gain, "s/Wb^2")
        known_start(self.start)
        check_filter(self.filter)

    def regression(
        self, F: Pass, u: Float[Array, " 2"], y: Float[Array, " 2"]
    ) -> Regression:
        """The regression `Y = omega'eta` that the observer searches."""
        F = F.using(self.filter, self.start)
        z = u - self.relation.resistance * y
        q = F.state("integral", jnp.zeros_like(z), z)
        mu = q - self.relation.inductance * y
        return Regression(q, 2.0 * F.p(mu, "mu"), -F.p(jnp.sum(mu * mu), "square"))

    def equations(self, F: Pass, u: Float[Array, " 2"], y: Float[Array, " 2"]) -> Estimate:
        q, omega, Y = self.regression(F, u, y)
        start = jnp.zeros_like(q) if self.initial is None else self.initial
        eta = F.evolve(_Gradient(self.gain * F.trust), (omega, Y), start, "eta")
        return Estimate(q + eta, jnp.ones_like(Y), jnp.asarray(False))
