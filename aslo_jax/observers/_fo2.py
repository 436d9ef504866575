"""FO2: the gradient observer of the flux by Ortega, Praly and others."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real, positive, real
from .._filters import AbstractLaw
from .._kinks import larger
from .._realise import Pass
from .._small import safe_rsqrt
from .._typing import PyTree, RealArray
from ..plants import FluxRelation
from ._base import AbstractObserver, Estimate
from ._relaxation import relaxation

__all__ = ["FO2"]


class _Drive(NamedTuple):
    rate: Float[Array, " 2"]  # u - R i
    centre: Float[Array, " 2"]  # L i


class _Radial(AbstractLaw):
    """`X' = rate - gain x (|x|^2 - m^2)` with `x = X - centre`; clipped below at zero.

    The correction alone moves x along its own ray, `s' = -2 gain s (s - m^2)` with
    `s = |x|^2`, a logistic equation: `s / s(0) = 1 / (a + s(0) (1 - a) / m^2)` with
    `a = exp(-2 gain m^2 h)`. Sampled: half of it, the integral, the other half (Strang).
    Second order, stable whatever the gain, and a flux on the circle is left there.
    """

    gain: Float[Array, ""]
    magnet_flux: Float[Array, ""]
    one_sided: bool = eqx.field(static=True)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        x = X - v.centre
        excess = jnp.sum(x * x) - self.magnet_flux**2
        if self.one_sided:
            excess = larger(excess, 0.0)
        return v.rate - self.gain * excess * x

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.gain.dtype)

    def _correct(self, X: Array, centre: Array, h: Array) -> Array:
        x, square = X - centre, self.magnet_flux**2
        s = jnp.sum(x * x)
        rate = 2.0 * self.gain * square
        shrink = jnp.exp(-rate * h) + 2.0 * self.gain * s * relaxation(rate, h)
        factor = safe_rsqrt(shrink)
        if self.one_sided:
            factor = jnp.where(s > square, factor, 1.0)
        return centre + factor * x

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        half = 0.5 * coefficients
        X = self._correct(X, v0.centre, half)
        return self._correct(X + half * (v0.rate + v1.rate), v1.centre, half)


class FO2(AbstractObserver):
    """`flux' = u - R i - gain x max(0, |x|^2 - m^2)`, `x = flux - L i`: a gradient search
    on the known magnet flux m.

    - `relation`: all of its parts are used, `magnet_flux` too;
    - `gain`, in 1/(s Wb^2): near the circle |x| = m its distance decays at the rate
      `2 gain m^2`; of the order of 1000. Any gain is stable when sampled;
    - `one_sided`: correct only outside of the circle (the `max`), as printed and in VESC's
      firmware (with half this gain); `False` corrects inside of it too, as in ODrive's;
    - `initial`: the flux at the first instant (Wb), shape `(2,)`; zero by default. Without
      the `max`, x = 0 is an equilibrium, left as soon as the motor turns.

    The estimate is the stator flux (Wb), shape `(2,)`. It has no certificate: at standstill
    x settles anywhere on the circle (or, one-sided, stays inside of it).

    Source: Ortega, Praly, Astolfi, Lee, Nam, IEEE Trans. Control Syst. Technol. 19 (2011)
    601-614; Lee, Hong, Nam, Ortega, Astolfi, Praly, IEEE Trans. Power Electron. 25 (2010)
    290-297; paper, eq. (flux_Praly); theory, section 7.
    """

    relation: FluxRelation
    gain: Float[Array, ""] = eqx.field(converter=real)
    one_sided: bool = eqx.field(static=True, default=True)
    initial: Float[Array, " 2"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        positive("gain", self.gain, "1/(s Wb^2)")
        positive("relation.magnet_flux", self.relation.magnet_flux, "Wb")

    def equations(self, F: Pass, u: Float[Array, " 2"], y: Float[Array, " 2"]) -> Estimate:
        relation = self.relation
        drive = _Drive(u - relation.resistance * y, relation.inductance * y)
        law = _Radial(self.gain * F.trust, relation.magnet_flux, self.one_sided)
        start = jnp.zeros_like(drive.rate) if self.initial is None else self.initial
        flux = F.evolve(law, drive, start, "flux")
        return Estimate(flux, jnp.ones_like(flux[0]), jnp.asarray(False))
