"""The guard: coasting on the known derivative while the state is not observable."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._checks import optional_real, positive, real
from ._filters import AbstractLaw
from ._kinks import clip
from ._module import Module
from ._realise import Pass
from ._relations import AbstractTerms
from ._typing import PyTree, RealArray

__all__ = ["Guard", "Memory"]


class Memory(AbstractLaw):
    """What an estimate coasts from, driven by `(value, certified, trust, rate)`.

    Continuous: `c' = rate + tracking trust (value - c)`. Sampled: the certified value
    itself, and otherwise the memory carried on along the known derivative.
    """

    tracking: Float[Array, ""]

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        value, _, trust, rate = v
        return rate + self.tracking * trust * (value - X)

    def discretise(self, h: RealArray | float) -> PyTree:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        value, certified, _, rate = v1
        half = jnp.asarray(0.5 * coefficients, X.dtype)
        return jnp.where(certified, value, X + half * (v0[-1] + rate))


class Guard(Module):
    """Lets an algebraic estimate through while its certificate is above `threshold`, and
    otherwise coasts: the last certified estimate (at the start, the initial guess)
    propagated along the known derivative `x' = A x + z`.

    - `threshold`: dimensionless, compared with the reciprocal condition number that the
      completion returns. By default only rounding is guarded against: the machine epsilon
      to the power 3/4 (2e-12 in float64, 6e-6 in float32). Against noise of relative size
      `e` on the signals choose about `e**2`.
    - `tracking`: in continuous time, the rate (rad/s) at which the memory follows the
      certified estimate; in sampled time it is the certified estimate.

    Source: theory, section 3.
    """

    threshold: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)
    tracking: Float[Array, ""] = eqx.field(converter=real, default=50.0)

    def __check_init__(self) -> None:
        positive("tracking", self.tracking, "rad/s")
        if self.threshold is not None:
            positive("threshold", self.threshold)

    def _threshold(self, certificate: Float[Array, ""]) -> Float[Array, ""]:
        if self.threshold is None:
            return jnp.asarray(jnp.finfo(certificate.dtype).eps ** 0.75, certificate.dtype)
        return self.threshold

    def certified(self, certificate: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether the algebraic estimate is let through."""
        return certificate > self._threshold(certificate)

    def trust(
        self, certificate: Float[Array, ""], widening: float = 1e3
    ) -> Float[Array, ""]:
        """The weight, from 0 to 1, that corrections towards the algebraic estimate have in
        continuous time: 0 at the threshold, rising to 1 over a width of one threshold, or
        of `widening` times the default one where that is more (at most 0.01), since there
        rounding has become small.

        Without a step, an adaptive solver does not stumble at the threshold."""
        threshold = self._threshold(certificate)
        rounding = min(widening * float(jnp.finfo(certificate.dtype).eps) ** 0.75, 1e-2)
        width = jnp.maximum(threshold, rounding)
        return clip((certificate - threshold) / width, 0.0, 1.0)

    def __call__(
        self,
        F: Pass,
        x: Float[Array, " n"],
        certificate: Float[Array, ""],
        terms: AbstractTerms,
        initial: Float[Array, " n"],
    ) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
        """The guarded estimate, shape `(n,)`, and whether it coasts, shape `()`."""
        certified = self.certified(certificate)
        if not F.certain:
            certified = certified & ~F.missing
        # The memory follows fast and serves later: it can wait for rounding to vanish.
        trust = self.trust(certificate, widening=1e6)
        c = F.evolve(
            Memory(self.tracking),
            lambda c: (x, certified, trust, terms.drift(c)),
            initial,
            "memory",
        )
        return jnp.where(certified, x, c), ~certified
