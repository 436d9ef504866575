"""Observers of observers: side by side, joined, and in stages."""

from collections.abc import Callable
from typing import Any, Generic

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._realise import Pass
from .._typing import PyTree
from ._base import AbstractObserver, Estimate, First, Second, check_observers, named

__all__ = ["Joined", "SideBySide", "Staged"]


def _coasting(estimate: Any) -> Bool[Array, ""]:
    """Whether an estimate, or one of a tree of them, coasts."""
    each = jax.tree.leaves(estimate, is_leaf=lambda e: isinstance(e, Estimate))
    found = jnp.asarray(False)
    for one in each:
        found = found | one.coasting
    return found


class SideBySide(AbstractObserver[dict[str, First]], Generic[First]):
    """Several `observers`, by name, of the same signals as one; the estimate is a
    dictionary of theirs by the same names.
    """

    observers: dict[str, AbstractObserver[First]] = eqx.field(converter=named)

    def __check_init__(self) -> None:
        check_observers(self.observers)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> dict[str, First]:
        return {
            name: observer(F.scope(name), u, y) for name, observer in self.observers.items()
        }


class Joined(AbstractObserver):
    """Several observers, `parts`, of the same signals as one, whose estimate is theirs one
    after the other, as the hidden part of a plant may be. Its certificate is the least of
    theirs, and it coasts if one of them does.
    """

    parts: tuple[AbstractObserver, ...]

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        each = [
            part(F.scope(f"part{k}"), u, y) for k, part in enumerate(self.parts, start=1)
        ]
        return Estimate(
            jnp.concatenate([e.value for e in each]),
            jnp.min(jnp.stack([e.certificate for e in each])),
            jnp.any(jnp.stack([e.coasting for e in each])),
        )


class Staged(AbstractObserver[dict[str, First | Second]], Generic[First, Second]):
    """A first observer, and a second one that measures what `connect` makes of its
    estimate.

    - `connect(u, y, estimate) -> (u, y)`: the signals of the second stage.

    The estimate is a dictionary with the entries `first` and `second`. While the first
    stage coasts, the second does not correct by what it measures (a [`PhaseLockedLoop`][]
    starts where it no longer does).
    """

    first: AbstractObserver[First]
    second: AbstractObserver[Second]
    connect: Callable[[PyTree, PyTree, First], tuple[PyTree, PyTree]]

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> dict[str, First | Second]:
        first = self.first(F.scope("first"), u, y)
        u, y = self.connect(u, y, first)
        doubted = _coasting(first)
        second = self.second(F.scope("second").doubting(doubted), u, y)
        return {"first": first, "second": second}
