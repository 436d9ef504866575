"""The observer of the states of a model, by a derived relation."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real
from .._filters import AbstractFilter
from .._guard import Guard
from .._module import Module
from .._realise import Pass
from .._relations import AbstractTerms, Row
from .._typing import PyTree
from ..observers import (
    AbstractObserver,
    Adaptive,
    AdaptiveEstimate,
    AlgebraicObserver,
    Asymptotic,
    Estimate,
    Lifted,
)
from .changes import Change
from .decoding import Decoder
from .dictionary import Matrix
from .relation import DerivedRelation
from .symbols import Program


class Coordinates(Module):
    """From the x of a relation to the states of the model, and how these change; `p` are
    the parameters of the model, in order.

    - `decoder`, `rates`: the code of both; `middle`: values of states that are not found;
      `half`: those of the half widths of the ranges of all;
    - `change`: the coordinates that the relation is in, where they are not the model's.
    """

    decoder: Decoder = eqx.field(static=True)
    rates: Program = eqx.field(static=True)
    middle: tuple[float, ...] = eqx.field(static=True)
    half: tuple[float, ...] = eqx.field(static=True)
    change: Change | Matrix | None = eqx.field(static=True, default=None)

    def states(
        self, p: Sequence[Any], X: Float[Array, "*batch n"], y: Float[Array, "*batch p"]
    ) -> tuple[Float[Array, "*batch k"], Float[Array, "*batch"]]:
        """The states that are found, from the x of the relation and what is measured, and
        their worth beside that of x, one at most."""
        found, worth = self.decoder(X, p)
        if self.change is None:
            return found, worth
        places = jnp.array(self.decoder.states)
        full = jnp.zeros((*found.shape[:-1], len(self.middle)), found.dtype)
        change = self.change
        back = jnp.vectorize(lambda x, y: change.back(x, y, p), signature="(n),(p)->(n)")
        return back(full.at[..., places].set(found), y)[..., places], worth

    def rate(
        self,
        p: Sequence[Any],
        x: Float[Array, " k"],
        u: Float[Array, " m"],
        y: Float[Array, " p"],
    ) -> Float[Array, " k"]:
        """Their derivatives by the model."""
        full: list[Any] = list(self.middle)
        for place, value in zip(self.decoder.states, x, strict=True):
            full[place] = value
        found = self.rates({"x": full, "y": y, "u": u, "p": p})
        return jnp.stack([jnp.asarray(found[k], x.dtype) for k in self.decoder.states])


class _Motion(AbstractTerms):
    """The known derivative of the states, to coast along."""

    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None
    observer: "StateObserver"
    u: Array
    y: Array

    def row(self, F: Pass) -> Row:
        raise NotImplementedError

    def drift(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        return self.observer.rate(x, self.u, self.y)


class StateObserver(AbstractObserver):
    """The states of a model, from a relation that was derived from it: the relation's x is
    solved for, the states are taken from it, and while these are not certified they coast
    along the model.

    - `observer`: of the relation, without a guard: algebraic, asymptotic, or the Kalman
      filter of it, with which the estimate has a covariance, of first order in that of x;
      with unknown parameters it is an [`AdaptiveEstimate`][], with flags of its own;
    - `coordinates`: of its x and of the states;
    - `guard`: of the states; `None` returns what the relation gives;
    - `initial`: the states before the first certified instant, shape `(k,)`, in their
      units; by default the middle of their ranges.
    """

    observer: AlgebraicObserver | Asymptotic | Lifted | Adaptive
    coordinates: Coordinates
    guard: Guard | None
    initial: Float[Array, " k"] | None = eqx.field(converter=optional_real, default=None)

    @property
    def relation(self) -> DerivedRelation:
        """The relation that it rests on."""
        inner = self.observer
        return (inner.observer if isinstance(inner, Asymptotic) else inner).relation  # pyright: ignore[reportReturnType]

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.relation.signals

    def rate(
        self, x: Float[Array, " k"], u: Float[Array, " m"], y: Float[Array, " p"]
    ) -> Float[Array, " k"]:
        """The derivatives of the states by the model (their units per second)."""
        return self.coordinates.rate(self.relation.values, x, u, y)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        found = self.decoded(self.observer(F.scope("lifted"), u, y), y)
        states = found.value
        if self.guard is None:
            return found
        middle = [self.coordinates.middle[k] for k in self.coordinates.decoder.states]
        initial = jnp.asarray(middle) if self.initial is None else self.initial
        motion = _Motion(states, None, self, u, y)
        value, coasting = self.guard(
            F.scope("guard"),
            states,
            found.certificate,
            motion,
            initial.astype(states.dtype),
        )
        return Estimate(value, found.certificate, coasting, found.covariance)

    def decoded(self, found: Estimate, y: PyTree) -> Estimate:
        """The estimate of the states from one of the relation's x. With a covariance the
        certificate is `1/(1 + r)`, r the largest variance of a state beside the square of
        half its range."""
        coordinates = self.coordinates
        of = lambda X: coordinates.states(self.relation.values, X, y)
        states, worth = of(found.value)
        if found.covariance is None:
            known = found.certificate
            known = known if coordinates.decoder.is_selection else known * worth
            return Estimate(states, known, found.coasting)
        J = jax.jacfwd(lambda X: of(X)[0])(found.value)
        P = J @ found.covariance @ J.T
        if isinstance(found, AdaptiveEstimate):
            return dataclasses.replace(found, value=states, covariance=P)
        half = jnp.asarray([coordinates.half[k] for k in coordinates.decoder.states])
        r = jnp.max(jnp.diagonal(P) / half.astype(P.dtype) ** 2)
        return Estimate(states, 1.0 / (1.0 + r), found.coasting, P)


def state_observer(
    relation: DerivedRelation,
    coordinates: Coordinates,
    filter: AbstractFilter,
    gain: Float[Array, ""] | float | None,
    initial: Any,
    **settings: Any,
) -> StateObserver:
    """The observer of the states with a `filter`."""
    guard = settings.pop("guard", Guard())
    # The A-ASLO follows what is certified, the ASLO decodes all and is guarded then.
    inner = None if gain is None else guard
    observer = AlgebraicObserver(relation, filter, guard=inner, **settings)
    whole = observer if gain is None else Asymptotic(observer, gain)
    return StateObserver(whole, coordinates, guard, initial)
