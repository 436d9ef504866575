"""Levitation in a one-axis magnetic bearing: state feedback over control of the fluxes."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._kinks import below, clip
from .._module import Module
from .._typing import PyTree, RealArray
from ..plants import MagneticBearing
from ._base import AbstractController

__all__ = ["BearingFeedback", "MagneticLevitation"]


class BearingFeedback(Module):
    """What a bearing controller is fed: `current` (A) and `flux` (Wb) of the coils, both of
    shape `(2,)`, the `position` (m) and the `velocity` (m/s) of the body, measured or
    estimated."""

    current: Float[Array, " 2"]
    flux: Float[Array, " 2"]
    position: Float[Array, ""]
    velocity: Float[Array, ""]


class MagneticLevitation(AbstractController):
    """State feedback with integral action on the position, over control of the fluxes.

    - `bearing`: what the gains are computed from;
    - `reference(t)`: the position (m) to hold;
    - `bias` (A): the current of both coils at the centre; it sets the `bias_flux` psi0 (Wb)
      that they share and the `force_limit` 4 psi0^2/k (N);
    - `bandwidth` b (rad/s): all three poles of the position are at -b;
    - `flux_bandwidth` (rad/s): of the fluxes, several times b;
    - `voltage_limit` (V), of each coil;
    - `ripple` (V), `ripple_frequency` (rad/s), `ripple_phase` (rad): a sinusoid on the
      voltage of coil 1, and on that of coil 2 ahead of it by the phase. The fluxes are
      asked to follow it, so it does not fight their control;
    - `rest` (s): until then the fluxes are raised equally, without a force.

    Equal and opposite changes d of the two fluxes make a force that is linear in d and
    independent of the position: `(psi1^2 - psi2^2)/k = 4 psi0 d/k`. So there is no
    negative stiffness to cancel, and what remains is a mass:
    `F = m (s - 3 b^2 q - 3 b q')`, `s' = b^3 (reference - q)`, that is `q = (b/(p + b))^3`
    times the reference. The integral follows a force of zero up to `rest`, takes over
    without a jump wherever the body rests, and is held back by what the force limit cuts
    off (back-calculation). The voltages are `R i + ripple + flux_bandwidth (error of psi)`.

    A body that is held still shows its position to no observer of [`MagneticBearing`][]:
    the rows of the flux relation are `(2/k) ((g - q) psi1, (g + q) psi2)` without their
    mean, so both fluxes must vary, and not in proportion. A ripple that is common
    (`ripple_phase` 0) or differential (pi) fills one direction only; a quarter of a period
    apart it fills both.

    Source: Schweitzer, Maslen, "Magnetic Bearings", 2009,
    doi:10.1007/978-3-642-00497-1 (flux control; self-sensing); theory, section 2, for the
    rows.
    """

    bearing: MagneticBearing
    reference: Callable[[Float[Array, ""]], Float[Array, ""]]
    bias: Float[Array, ""] = eqx.field(converter=real)
    bandwidth: Float[Array, ""] = eqx.field(converter=real, default=200.0)
    flux_bandwidth: Float[Array, ""] = eqx.field(converter=real, default=2000.0)
    voltage_limit: Float[Array, ""] = eqx.field(converter=real, default=1e6)
    ripple: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    ripple_frequency: Float[Array, ""] = eqx.field(converter=real, default=3000.0)
    ripple_phase: Float[Array, ""] = eqx.field(converter=real, default=jnp.pi / 2)
    rest: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        positive("bias", self.bias, "A")
        positive("bandwidth", self.bandwidth, "rad/s")
        positive("flux_bandwidth", self.flux_bandwidth, "rad/s")
        positive("voltage_limit", self.voltage_limit, "V")
        positive("ripple_frequency", self.ripple_frequency, "rad/s")

    @property
    def bias_flux(self) -> Float[Array, ""]:
        """The mean of the two fluxes (Wb)."""
        return 0.5 * self.bearing.force_constant * self.bias / self.bearing.gap

    @property
    def force_limit(self) -> Float[Array, ""]:
        """The force (N) at which one coil has no flux left."""
        return 4.0 * self.bias_flux**2 / self.bearing.force_constant

    def init(self, fed: BearingFeedback) -> Float[Array, ""]:
        return self._damping(fed)

    def _damping(self, fed: BearingFeedback) -> Float[Array, ""]:
        b, m = self.bandwidth, self.bearing.mass
        return 3.0 * m * b * (b * fed.position + fed.velocity)

    def force(
        self, t: Float[Array, ""], state: Float[Array, ""], fed: BearingFeedback
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The force (N) asked of the coils, and the derivative of the integral (N/s)."""
        b, m, damping = self.bandwidth, self.bearing.mass, self._damping(fed)
        wanted = state - damping
        force = clip(wanted, -self.force_limit, self.force_limit)
        error = self.reference(t) - fed.position
        rate = m * b**3 * error + b * (force - wanted)
        resting = below(t, self.rest)
        return jnp.where(resting, 0.0, force), jnp.where(resting, -b * wanted, rate)

    def excitation(
        self, t: Float[Array, ""]
    ) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """The ripple of the voltages (V), and of the fluxes that follow it (Wb)."""
        w = self.ripple_frequency
        phase = w * t + jnp.stack([0.0 * self.ripple_phase, self.ripple_phase])
        return self.ripple * jnp.cos(phase), self.ripple / w * jnp.sin(phase)

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        return self.force(t, state, fed)[1]

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        share = self.force(t, state, fed)[0] / self.force_limit
        ripple, follow = self.excitation(t)
        flux = self.bias_flux * jnp.stack([1.0 + share, 1.0 - share]) + follow
        drop = self.bearing.resistance * fed.current
        u = drop + ripple + self.flux_bandwidth * (flux - fed.flux)
        return clip(u, -self.voltage_limit, self.voltage_limit)
