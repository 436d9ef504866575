"""The open-loop integrator: what every observer must be better than."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real
from .._realise import Pass
from .._relations import AbstractTerms, terms_of
from .._typing import PyTree
from ._base import AbstractObserver, Estimate

__all__ = ["OpenLoopIntegrator"]


class OpenLoopIntegrator(AbstractObserver):
    """`x' = A x + z`, the known derivative integrated; `flux' = u - R i` of a PMSM.

    - `relation`: of its terms only the derivative is used;
    - `initial`: x at the first instant, shape `(n,)`, in its units; zero by default.

    Nothing is corrected: an error at the start stays, and an offset of the sensors makes it
    drift without bound (1 mV by 1 mWb/s). So its certificate is 0, and it always coasts.

    Source: paper, eq. (sys), the first line.
    """

    relation: Callable[[PyTree, PyTree], AbstractTerms]
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        terms = terms_of(self.relation, u, y)
        start = jnp.zeros_like(terms.z) if self.initial is None else self.initial
        x = F.state("integral", start, terms.drift)
        return Estimate(x, jnp.zeros_like(x[0]), jnp.asarray(True))
