"""What one pass over a set of equations does with their states: it allocates them
([`Start`][]), gives their derivatives ([`Flow`][]), or advances them over a sampling
interval ([`Advance`][]). States are addressed by name.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._laws import AbstractLaw
from ._swapped import Swapped
from ._typing import PyTree

__all__ = ["AbstractRealisation", "Advance", "Drive", "Flow", "Interval", "Start", "States"]

States = dict[str, Any]


class Interval(NamedTuple):
    """What a pass over one end of a sampling interval knows of it, where samples may be
    missing.

    - `missing`: whether one is, shape `()`;
    - `weight`: of what is injected over it, shape `()`: 1, or 0 where a sample is missing,
      or less than 1 where samples come back;
    - `before`: that of the interval before; `None` at the right end;
    - `blind`: whether the input is missing, shape `()`, and not the output alone.
    """

    missing: Bool[Array, ""]
    weight: Float[Array, ""]
    before: Float[Array, ""] | None
    blind: Bool[Array, ""]


Drive = PyTree | Callable[[PyTree], PyTree]


def state_of(states: States, name: str) -> PyTree:
    if name not in states:
        raise ValueError(
            f"Argument `state` must be a state of this observer, which has `{name}`, but "
            f"it holds {sorted(states)}; begin with `init`, or restore the right one."
        )
    return states[name]


def _at(drive: Drive, X: PyTree) -> PyTree:
    return drive(X) if callable(drive) else drive


class AbstractRealisation(abc.ABC):
    """What one pass over the equations does with each state. Lives for one pass only.

    **Raises:** `ValueError` where two states of a pass have one name.
    """

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._counts: dict[str, int] = {}

    @abc.abstractmethod
    def evolve(self, name: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        """The value, now, of the state `name` that follows `law` under `drive`."""

    @abc.abstractmethod
    def loop(
        self, name: str, law: AbstractLaw, start: PyTree
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        """[`evolve`][] in two parts, for a drive that needs the state by way of others: the
        value, now, and `close(drive)`, which returns the final value. When sampled, the
        first value is the predictor of Heun's method and the final one the corrected."""

    def shift(self, name: str, by: Array) -> None:
        """Add to the state `name` before the interval, at whose left end this pass is."""
        raise NotImplementedError(f"`{type(self).__name__}` has no interval to begin.")

    def claim(self, scope: str, name: str | None) -> str:
        """The full name of a new state: unique in the pass, the same in every pass."""
        if name is None:
            self._counts[scope] = self._counts.get(scope, 0) + 1
            name = f"state{self._counts[scope]}"
        full = scope + name
        if full in self._names:
            raise ValueError(
                f"Argument `name` must be unique, but the state `{full}` is defined twice; "
                "give each piece a scope of its own, `F.scope(...)`."
            )
        self._names.add(full)
        return full


class Start(AbstractRealisation):
    """Allocates the states: their names, shapes and first values."""

    def __init__(self) -> None:
        super().__init__()
        self.states: States = {}
        self.laws: dict[str, AbstractLaw] = {}

    def evolve(self, name: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        v = _at(drive, start) if start is not None else drive
        if start is None:
            start = jax.tree.map(jnp.zeros_like, v)
        self.states[name] = start
        self.laws[name] = law
        return start

    def loop(
        self, name: str, law: AbstractLaw, start: PyTree
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        def close(drive):
            return self.evolve(name, law, drive, start)

        return start, close

    def discretise(self, h: Float[Array, ""] | float) -> Mapping[str, PyTree]:
        """The coefficients of every law for intervals of `h` seconds, by state name."""
        found: dict[int, PyTree] = {}

        def once(law):
            if isinstance(law, Swapped):
                return once(law.law), h
            if id(law) not in found:
                found[id(law)] = law.discretise(h)
            return found[id(law)]

        return {name: once(law) for name, law in self.laws.items()}


class Flow(AbstractRealisation):
    """Reads the `states`, by name, and records every derivative and every drive."""

    def __init__(self, states: States) -> None:
        super().__init__()
        self.states = states
        self.rates: States = {}
        self.drives: States = {}

    def evolve(self, name: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        X = state_of(self.states, name)
        v = _at(drive, X)
        self.rates[name] = law.flow(X, v)
        self.drives[name] = v
        return X

    def shift(self, name: Any, by: Any) -> Any:
        self.states = {**self.states, name: state_of(self.states, name) + by}

    def loop(
        self, name: str, law: AbstractLaw, start: PyTree
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        def close(drive):
            return self.evolve(name, law, drive, start)

        return state_of(self.states, name), close


class Advance(AbstractRealisation):
    """Advances the states over an interval, evaluated at its right end, inner ones first.

    - `states`: at the left end, by name;
    - `coefficients`: of each law for the interval, as [`Start.discretise`][] gives them.

    `drives` are those of the left end. Afterwards `advanced` holds the new states and
    `drives` those of the right end, which are the left ones of an adjacent interval with
    the same input.
    """

    def __init__(
        self, states: States, drives: States, coefficients: Mapping[str, PyTree]
    ) -> None:
        super().__init__()
        self.states = states
        self.left = drives
        self.coefficients = coefficients
        self.advanced: States = {}
        self.drives: States = {}

    def evolve(self, name: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        if callable(drive):
            return self.loop(name, law, start)[1](drive)
        return self._finish(name, law, drive, drive)

    def loop(
        self, name: str, law: AbstractLaw, start: PyTree
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        left = self.left[name]
        predicted = law.advance(self.states[name], left, left, self.coefficients[name])

        def close(drive):
            return self._finish(name, law, drive, _at(drive, predicted))

        return predicted, close

    def _finish(self, name: str, law: AbstractLaw, drive: Drive, right: PyTree) -> PyTree:
        X, left = self.states[name], self.left[name]
        advanced = law.advance(X, left, right, self.coefficients[name])
        self.advanced[name] = advanced
        self.drives[name] = _at(drive, advanced)
        return advanced
