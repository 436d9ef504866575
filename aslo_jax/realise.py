"""One set of equations, realised as a start, a vector field, or a sampled recurrence.

An observer is a function `equations(F, u, y)` of a [`Pass`][] `F`. The same lines allocate
the states ([`Start`][]), give their derivatives ([`Flow`][]), or advance them over a
sampling interval ([`Advance`][]). States are addressed by name.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._typing import FilterStart, PyTree
from .filters import AbstractFilter, AbstractLaw, Integrator

__all__ = ["AbstractRealisation", "Advance", "Drive", "Flow", "Pass", "Start", "States"]

States = dict[str, Any]
Drive = PyTree | Callable[[PyTree], PyTree]


def _found(states: States, name: str) -> PyTree:
    if name not in states:
        raise ValueError(
            f"Argument `state` must be a state of this observer, which has `{name}`, but "
            f"it holds {sorted(states)}; begin with `init`, or restore the right one."
        )
    return states[name]


def _at(drive: Drive, X: PyTree) -> PyTree:
    return drive(X) if callable(drive) else drive


class AbstractRealisation(abc.ABC):
    """What one pass over the equations does with each state. Lives for one pass only."""

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
        distinct = {id(law): law for law in self.laws.values()}
        coefficients = {i: law.discretise(h) for i, law in distinct.items()}
        return {name: coefficients[id(law)] for name, law in self.laws.items()}


class Flow(AbstractRealisation):
    """Reads the states and records every derivative and every drive."""

    def __init__(self, states: States) -> None:
        super().__init__()
        self.states = states
        self.rates: States = {}
        self.drives: States = {}

    def evolve(self, name: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        X = _found(self.states, name)
        v = _at(drive, X)
        self.rates[name] = law.flow(X, v)
        self.drives[name] = v
        return X

    def loop(
        self, name: str, law: AbstractLaw, start: PyTree
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        def close(drive):
            return self.evolve(name, law, drive, start)

        return _found(self.states, name), close


class Advance(AbstractRealisation):
    """Advances the states over an interval, evaluated at its right end, inner ones first.

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


class Pass:
    """One pass over an observer's equations, with a filter bound to it.

    `F(s)` is the filtered signal F[s]; `F.p(s)` is pF[s], its filtered derivative;
    `F.one()` is F[1]; `F.hidden(v)` is a state `X' = A X + v` of the filter itself, from
    which `F.output` gives the filtered signal; `F.state(name, start, rate)` is any other
    state, `F.loop(law, start)` one that other signals feed back to. `F.using(filter)`
    binds a filter; `F.scope(name)` nests the names of states.

    With `start="exact"` every identity of the library holds for all t > 0; with
    `start="paper"` F[1] is taken as settled and every filter starts from zero, as printed.
    """

    def __init__(
        self,
        realisation: AbstractRealisation,
        filter: AbstractFilter | None = None,
        start: FilterStart = "exact",
        scope: str = "",
    ) -> None:
        self._realisation = realisation
        self._filter = filter
        self._start: FilterStart = start
        self._scope = scope

    @property
    def filter(self) -> AbstractFilter:
        if self._filter is None:
            raise ValueError("No filter is bound to this pass; bind one with `F.using`.")
        return self._filter

    @property
    def exact(self) -> bool:
        """Whether the start is exact."""
        return self._start == "exact"

    def using(self, filter: AbstractFilter, start: FilterStart | None = None) -> "Pass":
        """The same pass with `filter` bound to it."""
        mode = self._start if start is None else start
        return Pass(self._realisation, filter, mode, self._scope)

    def scope(self, name: str) -> "Pass":
        """The same pass with the names of its states nested under `name`."""
        return Pass(self._realisation, self._filter, self._start, f"{self._scope}{name}.")

    def evolve(
        self, law: AbstractLaw, drive: Drive, start: PyTree, name: str | None = None
    ) -> PyTree:
        """A state that follows `law` under `drive`, a value or a function of the state."""
        full = self._realisation.claim(self._scope, name)
        return self._realisation.evolve(full, law, drive, start)

    def loop(
        self, law: AbstractLaw, start: PyTree, name: str | None = None
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        """A state that feeds others which drive it: its value now, and `close(drive)`,
        which must be called once and returns the final value. The sampled scheme stays of
        second order."""
        full = self._realisation.claim(self._scope, name)
        return self._realisation.loop(full, law, start)

    def state(self, name: str, start: Array, rate: Drive) -> Array:
        """Any other state: `rate`, its derivative, is a value or a function of it."""
        return self.evolve(Integrator(), rate, start, name)

    def inject(self, s: Array | float) -> Array:
        """`B s`."""
        return self.filter.inject(s)

    def output(self, X: Array) -> Array:
        """`C X`."""
        return self.filter.output(X)

    def hidden(
        self, drive: Drive, name: str | None = None, start: Array | None = None
    ) -> Array:
        """`X' = A X + drive` from zero, or from `start`; a drive that depends on X needs
        one."""
        return self.evolve(self.filter, drive, start, name)

    def __call__(self, s: Array, name: str | None = None) -> Array:
        """`F[s]`, from zero."""
        return self.output(self.hidden(self.inject(s), name)) + self.filter.feedthrough(s)

    def settling(self, name: str | None = None) -> Array:
        """The hidden state of F[1]: from zero, or settled with the paper's start."""
        if not self.exact:
            return self.filter.equilibrium(1.0)
        return self.hidden(self.inject(1.0), name)

    def one(self, name: str | None = None) -> Array:
        """`F[1]`, equal to one with the paper's start."""
        return self.output(self.settling(name)) + self.filter.feedthrough(1.0)

    def p(self, s: Array, name: str | None = None, *, settled: bool | None = None) -> Array:
        """`pF[s]`, the filtered derivative, F starting `settled` at s(0) or from zero: by
        default settled with the exact start."""
        if not self.filter.strictly_proper:
            raise ValueError(
                "Argument `filter` must be strictly proper for a rate relation, since pF "
                "of a filter with feedthrough is improper; use `LowPass` or a "
                "`LinearFilter` with `D=None`."
            )
        v = self.inject(s)
        settled = self.exact if settled is None else settled
        start = self.filter.equilibrium(s) if settled else jnp.zeros_like(v)
        return self.output(self.filter.flow(self.hidden(v, name, start), v))
