"""The observer of the states of a model, by a derived relation."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real
from .._filters import AbstractFilter
from .._guard import Guard
from .._module import Module
from .._realise import Pass
from .._relations import AbstractTerms, Row
from .._typing import PyTree
from ..observers import AbstractObserver, AlgebraicObserver, Asymptotic, Estimate
from .changes import Change
from .decoding import Decoder
from .dictionary import Matrix
from .relation import DerivedRelation
from .symbols import Program


class Coordinates(Module):
    """From the x of a `relation` to the states of the model, and how these change.

    - `decoder`, `rates`: the code of both; `middle`: values of states that are not found;
    - `change`: the coordinates that the relation is in, where they are not the model's.
    """

    relation: DerivedRelation
    decoder: Decoder = eqx.field(static=True)
    rates: Program = eqx.field(static=True)
    middle: tuple[float, ...] = eqx.field(static=True)
    change: Change | Matrix | None = eqx.field(static=True, default=None)

    @property
    def parameters(self) -> tuple[Any, ...]:
        """The parameters of the model, in order."""
        return tuple(self.relation.parameters.values()) or self.relation.fixed

    def states(
        self, X: Float[Array, "*batch n"], y: Float[Array, "*batch p"]
    ) -> Float[Array, "*batch k"]:
        """The states that are found, from the x of the relation and what is measured."""
        found = self.decoder(X, self.parameters)
        if self.change is None:
            return found
        places = jnp.array(self.decoder.states)
        full = jnp.zeros((*found.shape[:-1], len(self.middle)), found.dtype)
        back = jnp.vectorize(self.change.back, signature="(n),(p)->(n)")
        return back(full.at[..., places].set(found), y)[..., places]

    def rate(
        self, x: Float[Array, " k"], u: Float[Array, " m"], y: Float[Array, " p"]
    ) -> Float[Array, " k"]:
        """Their derivatives by the model."""
        full: list[Any] = list(self.middle)
        for place, value in zip(self.decoder.states, x, strict=True):
            full[place] = value
        found = self.rates({"x": full, "y": y, "u": u, "p": self.parameters})
        return jnp.stack([jnp.asarray(found[k], x.dtype) for k in self.decoder.states])


class _Motion(AbstractTerms):
    """The known derivative of the states, to coast along."""

    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None
    coordinates: Coordinates
    u: Array
    y: Array

    def row(self, F: Pass) -> Row:
        raise NotImplementedError

    def drift(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        return self.coordinates.rate(x, self.u, self.y)


class StateObserver(AbstractObserver):
    """The states of a model, from a relation that was derived from it: the relation's x is
    solved for, the states are taken from it, and while these are not certified they coast
    along the model.

    - `observer`: of the relation, without a guard, algebraic or asymptotic;
    - `coordinates`: of its x and of the states;
    - `guard`: of the states; `None` returns what the relation gives;
    - `initial`: the states before the first certified instant, shape `(k,)`, in their
      units; by default the middle of their ranges.
    """

    observer: AlgebraicObserver | Asymptotic
    coordinates: Coordinates
    guard: Guard | None
    initial: Float[Array, " k"] | None = eqx.field(converter=optional_real, default=None)

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.coordinates.relation.signals

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        found = self.observer(F.scope("lifted"), u, y)
        states = self.coordinates.states(found.value, y)
        if self.guard is None:
            return Estimate(states, found.certificate, found.coasting)
        middle = [self.coordinates.middle[k] for k in self.coordinates.decoder.states]
        initial = jnp.asarray(middle) if self.initial is None else self.initial
        motion = _Motion(states, None, self.coordinates, u, y)
        value, coasting = self.guard(
            F.scope("guard"),
            states,
            found.certificate,
            motion,
            initial.astype(states.dtype),
        )
        return Estimate(value, found.certificate, coasting)


def state_observer(
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
    observer = AlgebraicObserver(coordinates.relation, filter, guard=inner, **settings)
    whole = observer if gain is None else Asymptotic(observer, gain)
    return StateObserver(whole, coordinates, guard, initial)
