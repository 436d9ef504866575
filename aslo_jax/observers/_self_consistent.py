"""An asymptotic observer whose relation uses its own estimate."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._completions import AbstractCompletion, LeastSquares
from .._filters import AbstractFilter
from .._guard import Guard
from .._realise import Pass
from .._relations import AbstractTerms
from .._signals import check_signals
from .._typing import PyTree
from ._algebraic import AlgebraicObserver
from ._asymptotic import _Average, _Correction, _Drive
from ._base import AbstractObserver, Estimate

__all__ = ["SelfConsistent"]


class SelfConsistent(AbstractObserver):
    """An A-ASLO, `x' = z - gain (x - x_algebraic)`, for a relation whose terms depend
    weakly on x itself, `relation(u, y, x)`, and take the observer's own estimate for it.

    - `relation`, `filter`, `completion`, `guard`: as of [`AlgebraicObserver`][];
    - `gain` (rad/s);
    - `initial`: the estimate at the first instant, shape `(n,)`, in the units of x;
    - `forget`: whether the algebraic estimate at the first certified instant takes its
      place, and the relation goes over from `initial` to the estimate at the rate `gain`,
      since a step in its terms would be filtered like a signal. By default `initial` is
      kept, and left at that rate.

    The estimate is the state where the two agree. There is no proof that they come to
    agree: for the flux of an interior PMSM they did from every start that was tried, up to
    Lq/Ld = 3.3 (theory, section 2).

    Source: theory, sections 2 (interior PMSM) and 4.
    """

    relation: Callable[[PyTree, PyTree, Float[Array, " n"]], AbstractTerms]
    filter: AbstractFilter
    gain: Float[Array, ""] = eqx.field(converter=real)
    initial: Float[Array, " n"] = eqx.field(converter=real)
    completion: AbstractCompletion = eqx.field(default_factory=LeastSquares)
    guard: Guard = eqx.field(default_factory=Guard)
    forget: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        positive("gain", self.gain, "rad/s")

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        check_signals(self.relation, type(self.relation).__call__, u, y)
        one = jnp.ones_like(self.initial[0])
        kept = _Average(one, self.initial)
        start = jax.tree.map(jnp.zeros_like, kept) if self.forget else kept
        X, close = F.loop(_Correction(self.gain), start, "average")

        def relation(u, y):
            terms = self.relation(u, y, X.estimate())
            if not self.forget:
                return terms
            first = self.relation(u, y, self.initial)
            return jax.tree.map(lambda a, b: a + X.weight * (b - a), first, terms)

        inner = AlgebraicObserver(
            relation, self.filter, self.completion, self.guard, initial=self.initial
        )
        algebraic = inner(F.scope("algebraic"), u, y)
        terms, certified = relation(u, y), ~algebraic.coasting
        trust = self.guard.trust(algebraic.certificate)

        def drive(X: _Average) -> _Drive:
            x = X.estimate()
            error = algebraic.value - x
            return _Drive(algebraic.value, certified, trust, terms.drift(x), error)

        X = close(drive)
        value = jnp.where(X.weight > 0, X.estimate(), algebraic.value)
        return Estimate(value, algebraic.certificate, algebraic.coasting)
