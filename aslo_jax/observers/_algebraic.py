"""The algebraic observer (ASLO): relation, filter, completion, guard."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import kind, known_start, optional_real
from .._completions import AbstractCompletion, LeastSquares
from .._filters import AbstractFilter, check_filter
from .._guard import Guard
from .._realise import Pass
from .._relations import AbstractTerms, terms_of
from .._typing import FilterStart, PyTree
from ._base import AbstractObserver, Estimate, check_initial

__all__ = ["AlgebraicObserver"]


class AlgebraicObserver(AbstractObserver):
    """The Algebraic Swapping Lemma Observer: unmeasured states from an algebraic relation
    between filtered inputs and outputs.

    - `relation`: `relation(u, y)` gives the terms of one equation in the unmeasured x;
    - `filter`: the filter of the Swapping Lemma;
    - `completion`: from one row to all entries of x;
    - `guard`: coasting while x is not observable; `None` returns the raw solution;
    - `start`: `"exact"`, the identity holds for every t > 0, or `"paper"`, F[1] settled
      and every filter from zero, as printed, with the transient that this has;
    - `initial`: the guess of x before the first certified instant, shape `(n,)`, in the
      units of x; zero by default.

    Source: Bobtsov, Romero, Ortega, Pyrkin, "An Algebraic State Observer for a Class of
    Physical Systems", Props 1 and 2; theory, sections 1 to 3.

    **Raises:** `ValueError` for an `initial` whose shape is not that of x, and what the
    relation, filter and completion refuse.
    """

    relation: Callable[[PyTree, PyTree], AbstractTerms]
    filter: AbstractFilter
    # Built when used: an array made on import has the precision of that moment.
    completion: AbstractCompletion = eqx.field(default_factory=LeastSquares)
    guard: Guard | None = eqx.field(default_factory=Guard)
    start: FilterStart = eqx.field(static=True, default="exact")
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        known_start(self.start)
        if not callable(self.relation):
            kind("relation", self.relation, hint="a relation, `relation(u, y)`")
        check_filter(self.filter)
        kind("completion", self.completion, AbstractCompletion, hint="a completion")
        kind("guard", self.guard, Guard, hint="a `Guard` or `None`")

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        F = F.using(self.filter, self.start)
        terms = terms_of(self.relation, u, y)
        row = terms.row(F.scope("row"))
        x, certificate = self.completion(F.scope("completion"), row)
        if self.guard is None:
            return Estimate(x, certificate, F.missing)
        initial = jnp.zeros_like(x) if self.initial is None else self.initial
        check_initial(initial, x)
        value, coasting = self.guard(F.scope("guard"), x, certificate, terms, initial)
        return Estimate(value, certificate, coasting)
