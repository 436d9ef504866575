"""The angle and the speed of a PMSM: from its flux, or directly."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import known_start, optional_real, real
from .._completions import AbstractCompletion, LeastSquares
from .._filters import AbstractFilter, check_filter
from .._guard import Guard
from .._module import Module
from .._realise import Pass
from .._relations import Row, terms_of
from .._small import safe_reciprocal
from .._typing import FilterStart, PyTree
from ..plants import FluxRelation
from ._base import AbstractObserver, Estimate
from ._compose import Staged
from ._pll import PhaseLockedLoop

__all__ = [
    "AlgebraicMagnet",
    "MagnetAngle",
    "electrical_angle",
    "rotor_angle",
    "track_angle",
]


def electrical_angle(magnet: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """The electrical angle in [-pi, pi] (rad) of the magnet's flux `magnet`, `flux - L i`
    (Wb), shape `(..., 2)`; zero, with finite gradients, where that vanishes.
    """
    a, b = magnet[..., 0], magnet[..., 1]
    return jnp.arctan2(b, jnp.where((a == 0) & (b == 0), 1.0, a))


def rotor_angle(
    flux: Float[Array, "*batch 2"],
    current: Float[Array, "*batch 2"],
    inductance: Float[Array, ""] | float,
    pole_pairs: int,
) -> Float[Array, "*batch"]:
    """The mechanical angle (rad) from the stator `flux` (Wb), shape `(..., 2)`, the
    `current` (A), shape `(..., 2)`, and the `inductance` L (H), known up to its period
    `2 pi / pole_pairs`: `atan2(flux_2 - L i_2, flux_1 - L i_1) / pole_pairs`.

    The paper prints the arctangent of the quotient, which is half a period off for half of
    the angles.

    Source: paper, O7, corrected; theory, sections 6 and 7.
    """
    return electrical_angle(flux - inductance * current) / pole_pairs


class MagnetAngle(Module):
    """For [`Staged`][]: the electrical angle as the measurement of the second stage, from a
    first one that estimates the stator flux, or the magnet's when `inductance` (H) is 0."""

    inductance: Float[Array, ""] = eqx.field(converter=real)

    def __call__(
        self, u: PyTree, y: Float[Array, " 2"], estimate: Estimate
    ) -> tuple[PyTree, Float[Array, ""]]:
        return u, electrical_angle(estimate.value - self.inductance * y)


def track_angle(
    observer: AbstractObserver,
    bandwidth: Float[Array, ""] | float,
    inductance: Float[Array, ""] | float,
) -> Staged:
    """`observer`, of the stator flux, followed by a [`PhaseLockedLoop`][] of `bandwidth`
    (rad/s): its `second` estimate is the electrical angle (rad, unwrapped) and the
    electrical speed (rad/s). Divide them by the pole pairs last. `inductance` (H) is 0 for
    an [`AlgebraicMagnet`][]."""
    return Staged(observer, PhaseLockedLoop(bandwidth), MagnetAngle(inductance))


class AlgebraicMagnet(AbstractObserver):
    """The angle directly: the magnet's flux `chi = m (cos, sin)`, with `chi' = u - R i -
    L i'`, from the row `r'chi = b - L r'i` and those that a completion makes of it.

    In every further row the Swapping Lemma eliminates i', which is not measured: the second
    one of [`Repeat`][] is `F[r]'chi = F[b - L r'i] + (1/lam) F[F[r]'z] - L (F[r]'i -
    F[r'i])`. A completion is linear in b and z, so that for any of them chi is what it
    makes of `(b - L r'i, z)`, less L times what i' adds: `i` less what it makes of
    `(r'i, 0)`.

    - `relation`, `filter`, `completion`, `guard`, `start`: as for [`AlgebraicObserver`][];
    - `initial`: the stator flux at the first instant (Wb), shape `(2,)`; zero by default.

    The estimate is chi (Wb), shape `(2,)`; [`electrical_angle`][] is its angle. The
    certificate is the completion's, times one less the relative error of |chi|^2 where the
    relation knows the magnet flux m: chi is found without m, which so tells what it is
    worth. While it coasts the flux is carried along. Algebraically chi is the flux estimate
    of [`AlgebraicObserver`][] less L i, with the same noise.

    Source: paper, O7; theory, section 7.
    """

    relation: FluxRelation
    filter: AbstractFilter
    completion: AbstractCompletion = eqx.field(default_factory=LeastSquares)
    guard: Guard | None = eqx.field(default_factory=Guard)
    start: FilterStart = eqx.field(static=True, default="exact")
    initial: Float[Array, " 2"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        known_start(self.start)
        check_filter(self.filter)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        F = F.using(self.filter, self.start)
        L, m = self.relation.inductance, self.relation.magnet_flux
        terms = terms_of(self.relation, u, y)
        row = terms.row(F.scope("row"))
        ry, zero = jnp.sum(row.r * y), jnp.zeros_like(row.z)
        x, certificate = self.completion(
            F.scope("magnet"), _with(row, row.b - L * ry, row.z)
        )
        of_y, _ = self.completion(F.scope("current"), _with(row, ry, zero))
        chi = x - L * (y - of_y)
        square = m * m
        excess = jnp.abs(jnp.sum(chi * chi) - square) * safe_reciprocal(square)
        certificate = certificate * jnp.clip(1.0 - excess, 0.0, 1.0)
        if self.guard is None:
            return Estimate(chi, certificate, F.missing)
        initial = zero if self.initial is None else self.initial
        flux, coasting = self.guard(
            F.scope("guard"), chi + L * y, certificate, terms, initial
        )
        return Estimate(flux - L * y, certificate, coasting)


def _with(row: Row, b: Float[Array, ""], z: Float[Array, " 2"]) -> Row:
    return Row(row.r, b, z, row.A, row.scale, row.constant)
