"""One set of equations, realised as a start, a vector field, or a sampled recurrence.

An observer is a function `equations(F, u, y)` of a [`Pass`][] `F`. The same lines allocate
the states ([`Start`][]), give their derivatives ([`Flow`][]), or advance them over a
sampling interval ([`Advance`][]). States are addressed by name.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._filters import AbstractFilter, AbstractLaw, Integrator
from ._typing import FilterStart, PyTree

__all__ = ["AbstractRealisation", "Advance", "Drive", "Flow", "Pass", "Start", "States"]

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
        distinct = {id(law): law for law in self.laws.values()}
        coefficients = {i: law.discretise(h) for i, law in distinct.items()}
        return {name: coefficients[id(law)] for name, law in self.laws.items()}


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


class Pass:
    """One pass over an observer's equations, with a filter bound to it.

    `F(s)` is the filtered signal F[s]; `F.p(s)` is pF[s], its filtered derivative;
    `F.one()` is F[1]; `F.hidden(v)` is a state `X' = A X + v` of the filter itself, from
    which `F.output` gives the filtered signal; `F.state(name, start, rate)` is any other
    state, `F.loop(law, start)` one that other signals feed back to. `F.using(filter)`
    binds a filter; `F.scope(name)` nests the names of states.

    - `realisation`: what is done with each state, a [`Start`][], [`Flow`][] or
      [`Advance`][]; `scope`: what the names of states begin with;
    - `interval`: what the pass knows of samples that are missing, `None` where none can
      be; `doubted`, shape `()`: whether its measurements are not to be trusted.

    With `start="exact"` every identity of the library holds for all t > 0; with
    `start="paper"` F[1] is taken as settled and every filter starts from zero, as printed.

    **Raises:** `ValueError` where `F` is called without a filter, for `F.p` with a filter
    that is not strictly proper, and for two states of one name.
    """

    def __init__(
        self,
        realisation: AbstractRealisation,
        filter: AbstractFilter | None = None,
        start: FilterStart = "exact",
        scope: str = "",
        interval: Interval | None = None,
        doubted: Bool[Array, ""] | None = None,
    ) -> None:
        self._realisation = realisation
        self._filter = filter
        self._start: FilterStart = start
        self._scope = scope
        self._interval = interval
        self._doubted = doubted

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
        return self._with(filter=filter, start=mode)

    def scope(self, name: str) -> "Pass":
        """The same pass with the names of its states nested under `name`."""
        return self._with(scope=f"{self._scope}{name}.")

    def doubting(self, doubted: Bool[Array, ""]) -> "Pass":
        """The same pass for what measures something `doubted`, shape `()`: no correction by
        it is trusted."""
        if self._doubted is not None:
            doubted = doubted | self._doubted
        return self._with(doubted=doubted)

    def _with(self, **changed: Any) -> "Pass":
        kept = {
            "filter": self._filter,
            "start": self._start,
            "scope": self._scope,
            "interval": self._interval,
            "doubted": self._doubted,
        }
        return Pass(self._realisation, **(kept | changed))

    @property
    def certain(self) -> bool:
        """Whether no sample can be missing in this pass, nor doubted, which is known while
        tracing."""
        return self._interval is None and self._doubted is None

    @property
    def missing(self) -> Bool[Array, ""]:
        """Whether a sample of this interval is missing or doubted, shape `()`."""
        missing = jnp.asarray(False) if self._interval is None else self._interval.missing
        return missing if self._doubted is None else missing | self._doubted

    @property
    def blind(self) -> Bool[Array, ""]:
        """Whether the input of this interval is missing, shape `()`."""
        return jnp.asarray(False) if self._interval is None else self._interval.blind

    @property
    def trust(self) -> Float[Array, ""] | float:
        """What a correction by a measurement is to be multiplied by: 1, and 0 over an
        interval of which a sample is missing."""
        return 1.0 if self.certain else jnp.where(self.missing, 0.0, 1.0)

    @property
    def weight(self) -> Float[Array, ""] | float:
        """The weight of what is injected: 1, and 0 where a sample is missing."""
        return 1.0 if self._interval is None else self._interval.weight

    def measured(self, y: Array, predicted: Array) -> Array:
        """y, or over an interval of which a sample is missing what the observer predicts
        in its place, so that it corrects nothing."""
        return y if self.certain else jnp.where(self.missing, predicted, y)

    def apart(
        self, name: str | None, by: Callable[[], Array], *, whole: bool = False
    ) -> str:
        """The full name of a new state that follows a measured signal, which jumps where
        samples come back: while they are missing it is kept less `by()`, a function of
        that signal, and where they come back, unless `whole`, less what of that has no
        weight."""
        full = self._realisation.claim(self._scope, name)
        if self._interval is not None and self._interval.before is not None:
            now, before = self._interval.weight, self._interval.before
            if whole:
                now, before = jnp.sign(now), jnp.sign(before)
            self._realisation.shift(full, (now - before).astype(by().dtype) * by())
        return full

    def evolve(
        self, law: AbstractLaw, drive: Drive, start: PyTree, name: str | None = None
    ) -> PyTree:
        """A state that follows `law` under `drive`, a value or a function of the state."""
        full = self._realisation.claim(self._scope, name)
        return self._realisation.evolve(full, law, drive, start)

    def continued(self, full: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        """[`evolve`][] of a state whose full name [`apart`][] gave."""
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
        """`B s`; with the exact start nothing over an interval of which a sample is
        missing: a row with every injection weighted alike still holds."""
        v = self.filter.inject(s)
        return self.weight * v if self.exact and self._interval is not None else v

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
        v = self.filter.inject(s)
        settled = self.exact if settled is None else settled
        start = self.filter.equilibrium(s) if settled else jnp.zeros_like(v)
        # While samples are missing the state is kept less its equilibrium, so that F[s'] is
        # A X and decays, and s goes on from where it comes back.
        v = v if self._interval is None else self.weight * v
        full = self.apart(name, lambda: self.filter.equilibrium(s))
        X = self.continued(full, self.filter, v, start)
        return self.output(self.filter.flow(X, v))
