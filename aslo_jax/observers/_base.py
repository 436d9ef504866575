"""The protocol of every observer."""

import abc
import functools
import typing
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from .._checks import check_substeps, kind, number, positive, unlike
from .._laws import Hold, Remembering
from .._module import Module
from .._realise import Advance, Flow, Interval, Pass, Start, States, state_of
from .._signals import check_signals
from .._typing import PyTree
from ._missing import DOUBT, Gap, either, marked, whole

__all__ = [
    "AbstractObserver",
    "Est",
    "Estimate",
    "First",
    "ObserverState",
    "Second",
    "check_observers",
    "named",
]


class Estimate(Module):
    """An estimate and what is known about it.

    - `value`: the estimated states, shape `(n,)`, in their own units;
    - `certificate`: a dimensionless measure of observability, shape `()`, see
      [`AbstractCompletion`][]; 1 for an observer that has none;
    - `coasting`: whether `value` is carried along the known derivative because the state
      is not observable now, or because the sample is missing, shape `()`;
    - `covariance`: that of `value`, shape `(n, n)`, in products of its units, where the
      observer knows it.
    """

    value: Float[Array, "*batch n"]
    certificate: Float[Array, "*batch"]
    coasting: Bool[Array, "*batch"]
    covariance: Float[Array, "*batch n n"] | None = None

    def to_dataframe(
        self,
        t: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Any:
        """An estimate over time as a `pandas.DataFrame` (the extra `study`).

        - `t`: the instants that `replay` had (s), shape `(N,)`, which become the index `t`;
        - `names` of the `n` entries of the value, by default `value_0` and so on;
        - `units`: by column, kept in `attrs["units"]` of the table.

        The other columns are `certificate` (1) and `coasting`.

        **Raises:** `ValueError` for instants or names that do not fit, for a batch of
        estimates, or for the unit of no column; `ImportError` naming the command that
        installs pandas.
        """
        from .._tables import dataframe, estimate_columns

        return dataframe(estimate_columns(self, t, names), units or {})

    def to_xarray(
        self,
        t: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Any:
        """The same as an `xarray.Dataset`: one variable for each column of
        [`Estimate.to_dataframe`][], over the coordinate `t` (s), with its unit in the
        attribute `units`."""
        from .._tables import dataset, estimate_columns

        return dataset(estimate_columns(self, t, names), units or {})


class ObserverState(Module):
    """The state of an observer, a value: save it, restore it, batch it.

    - `states`: every filter and other state, by name;
    - `y`: the last measurement, from which the next sampling interval begins;
    - `gap`: what is remembered in case a sample is missing; `None` in continuous time.
    """

    states: States
    y: PyTree
    gap: Gap | None = None


# What an observer estimates: an `Estimate`, unless a class says otherwise, such as
# `AbstractObserver[dict[str, Estimate]]`.
if TYPE_CHECKING:
    from typing_extensions import TypeVar

    Est = TypeVar("Est", default=Estimate, covariant=True)
    First = TypeVar("First", default=Estimate)
    Second = TypeVar("Second", default=Estimate)
else:
    Est = typing.TypeVar("Est", covariant=True)
    First = typing.TypeVar("First")
    Second = typing.TypeVar("Second")


class AbstractObserver(Module, Generic[Est]):
    """A state observer, written once as `equations` and run in continuous time
    (`vector_field`, `estimate`) or sampled (`step`). For type checkers it is generic in
    what it estimates: `AbstractObserver` is `AbstractObserver[Estimate]`.

    Conventions: `y[k]` is sampled at `t[k]`; `u[k]` is held on `[t[k], t[k+1])`. No
    estimate has direct feed-through of u.

    **Raises:** `ValueError` for `substeps` below 1 or above 1000, a `dt` that is not
    positive, the state of another observer, and what its own equations refuse.
    """

    @abc.abstractmethod
    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Est:
        """The observer's equations: a pass `F`, the input `u` and the measurement `y`, to
        an [`Estimate`][] (or a dictionary of them, for observers side by side)."""

    def __call__(self, F: Pass, u: PyTree, y: PyTree) -> Est:
        """[`equations`][], of signals with the shapes that they declare: what each way to
        run them calls, and what an observer calls that is made of others."""
        check_signals(self, type(self).equations, u, y)
        F = F.observing(u, y)
        estimate = self.equations(F, u, y)
        F.close(estimate)
        return estimate

    def init(self, y: PyTree, u: PyTree | None = None) -> ObserverState:
        """The state at the first measurement `y`; where that is not finite, the observer
        begins at the first one that is. Of `u` only the shape matters, which by default is
        that of y."""
        y = jax.tree.map(jnp.asarray, y)
        gap, y = Gap.before(self._input(y, u), y)
        return ObserverState(self.allocate(y, u).states, y, gap)

    def allocate(self, y: PyTree, u: PyTree | None = None) -> Start:
        """The pass that allocates the states; it knows the laws they follow."""
        start = Start()
        self(Pass(start), self._input(y, u), y)
        return start

    def _input(self, y: PyTree, u: PyTree | None) -> PyTree:
        if u is None:
            shape = getattr(self, "signals", {}).get("u")
            y0 = jnp.zeros(shape, jnp.result_type(float)) if shape is not None else y
            u = jax.tree.map(jnp.zeros_like, y0)
        return jax.tree.map(jnp.asarray, u)

    def vector_field(
        self, t: Float[Array, ""], state: ObserverState, u: PyTree, y: PyTree
    ) -> ObserverState:
        """The derivative of `state` at time `t` (s); that of its `y` is zero."""
        del t
        flow = Flow(state.states)
        self(Pass(flow), u, y)
        still = jax.tree.map(jnp.zeros_like, (state.y, state.gap))
        return ObserverState(flow.rates, *still)

    def estimate(
        self, t: Float[Array, ""], state: ObserverState, u: PyTree, y: PyTree
    ) -> Est:
        """The estimate at time `t` (s), in continuous time."""
        del t
        return self(Pass(Flow(state.states)), u, y)

    def step(
        self,
        state: ObserverState,
        u: PyTree,
        y: PyTree,
        dt: Float[Array, ""] | float,
        *,
        substeps: int = 1,
    ) -> tuple[ObserverState, Est]:
        """One sample of a control loop: `u` was held over the `dt` seconds that end now,
        `y` is measured now. Returns the new state and the estimate now.

        `substeps` split the interval with interpolated y, where products of signals curve
        within it. Compile a loop of steps with `eqx.filter_jit`; single calls take half the
        time by `jax.jit` of a function that closes over the observer.

        A sample with an entry that is not finite is missing, as [`take`][] says.
        """
        number("dt", dt, "s")
        positive("dt", dt, "s")
        kind("state", state, ObserverState, hint="a state of this observer, from `init`")
        u, y = jax.tree.map(jnp.asarray, (u, y))
        self._check_measured(state, u, y)
        interval = jnp.asarray(dt) / max(substeps, 1)
        coefficients = self.allocate(state.y, u).discretise(interval)
        return self.take(state, u, y, dt, coefficients, substeps=substeps)

    def take(
        self,
        state: ObserverState,
        u: PyTree,
        y: PyTree,
        dt: Float[Array, ""] | float,
        coefficients: PyTree,
        *,
        substeps: int = 1,
    ) -> tuple[ObserverState, Any]:
        """[`step`][] with the coefficients of the laws already at hand: [`advance`][], and
        a `u` or a `y` with an entry that is not finite counts as missing.

        Over an interval that ends with a missing y, or whose u is missing, nothing is
        injected into a filter and nothing is corrected: the estimate is carried along its
        known derivative, with the signals that were last known, and `coasting` says so.
        When y comes back, its interval begins on the line between it and the last y that
        was known, and counts for its part of the time between the two. Rows of
        the exact start hold through a hole but for the error of that derivative over it,
        which is forgotten at the rate of the filters; it is small where nothing turns by
        more than about a tenth of a radian meanwhile. After a longer hole the estimate is
        flagged until the slowest filter has forgotten it to about 5 %. Before the first y
        that is finite nothing is known; there the observer begins.
        """
        check_substeps(substeps)
        self._check_measured(state, u, y)
        gap = Gap.before(u, state.y)[0] if state.gap is None else state.gap
        y = self.continued(state.y, y)
        now = whole(gap, state.y, u, y, dt, _kept(coefficients, substeps))
        begun = self.allocate(now.y, now.u).states
        check_states(state.states, begun)
        states = either(now.first, begun, state.states)
        weight, before = now.weights
        end = Interval(now.missing, weight, None, now.blind)
        ends = end._replace(before=before), end
        states, estimate = self._across(
            states, now.u, now.left, now.y, coefficients, substeps, ends
        )
        doubtful = now.missing | (now.gap.doubt > DOUBT)
        estimate = marked(estimate, doubtful, Estimate)
        return ObserverState(states, now.y, now.gap), estimate

    def _check_measured(self, state: ObserverState, u: PyTree, y: PyTree) -> None:
        """Refuse a y of another shape than that of the last one, or a state of such a y."""
        got, last = (jax.tree.map(jnp.shape, each) for each in (y, state.y))
        if got != last:
            self.allocate(y, u)  # which refuses y, where it is y that does not fit
            raise ValueError(
                f"Argument `state` must be a state of this observer, for a `y` of shape "
                f"{got}, but it holds one of shape {last}; begin with `init`."
            )

    def continued(self, before: PyTree, y: PyTree) -> PyTree:
        """The measurement y as the observer takes it, after the one `before`."""
        del before
        return y

    def advance(
        self,
        state: ObserverState,
        u: PyTree,
        y: PyTree,
        coefficients: PyTree,
        *,
        substeps: int = 1,
    ) -> tuple[ObserverState, Est]:
        """[`step`][] with the coefficients of the laws, `allocate(y, u).discretise(dt /
        substeps)`, already at hand, for samples none of which is missing."""
        y = self.continued(state.y, y)
        states, estimate = self._across(
            state.states, u, state.y, y, coefficients, substeps, (None, None)
        )
        gap = None if state.gap is None else state.gap.after(u)
        return ObserverState(states, y, gap), estimate

    def _across(
        self,
        states: States,
        u: PyTree,
        before: PyTree,
        y: PyTree,
        coefficients: PyTree,
        substeps: int,
        ends: tuple[Interval | None, Interval | None],
    ) -> tuple[States, Any]:
        """The states after an interval from `before` to `y`, and the estimate there."""
        check_substeps(substeps)
        left = Flow(states)
        self(Pass(left, interval=ends[0]), u, before)
        states, drives = left.states, left.drives
        if substeps > 1:

            def piece(at_left, theta):
                right = Advance(at_left[0], at_left[1], coefficients)
                self(Pass(right, interval=ends[1]), u, _between(before, y, theta))
                return (right.advanced, right.drives), None

            inner = jnp.arange(1, substeps) / substeps
            (states, drives), _ = jax.lax.scan(piece, (states, drives), inner)
        right = Advance(states, drives, coefficients)
        estimate = self(Pass(right, interval=ends[1]), u, y)
        return right.advanced, estimate


def named(
    observers: Mapping[str, AbstractObserver[Est]],
) -> dict[str, AbstractObserver[Est]]:
    """Observers by name, as a dictionary; what is none is left to [`check_observers`][]."""
    return dict(observers) if isinstance(observers, Mapping) else observers


def _kept(coefficients: PyTree, substeps: int) -> tuple[Any, Any] | None:
    """What the slowest filter remembers over an interval, by its slowest part and as a
    whole; `None` without a filter."""
    is_filter = lambda x: isinstance(x, Hold | Remembering)
    found = jax.tree.leaves(coefficients, is_leaf=is_filter)
    parts = [(x.slowest, x.whole) for x in found if isinstance(x, Remembering)]
    holds = [x.decay for x in found if isinstance(x, Hold) and jnp.ndim(x.decay) == 0]
    parts += [(decay, decay) for decay in holds]
    if not parts:
        return None
    greatest = (functools.reduce(jnp.maximum, each) for each in zip(*parts, strict=True))
    power = lambda x: functools.reduce(lambda a, b: a * b, [x] * substeps)
    slowest, whole = map(power, greatest)
    return slowest, whole


def check_states(states: States, begun: States) -> None:
    """Refuse `states` of other names or shapes than those with which an observer begins."""
    for name, first in begun.items():
        shapes = [jax.tree.map(jnp.shape, x) for x in (first, state_of(states, name))]
        structures = [jax.tree.structure(x) for x in (first, states[name])]
        if shapes[0] != shapes[1] or structures[0] != structures[1]:
            raise ValueError(
                f"Argument `state` must be a state of this observer, whose `{name}` has "
                f"the shape {shapes[0]}, but it holds {shapes[1]}; begin with `init`, or "
                "restore the right one."
            )
    if others := sorted(set(states) - set(begun)):
        raise ValueError(
            f"Argument `state` must be a state of this observer, which has no {others}; "
            "begin with `init`, or restore the right one."
        )


def check_initial(initial: Array, x: Array) -> None:
    """Refuse a guess that is not like the estimated state x."""
    if jnp.shape(initial) != x.shape:
        raise ValueError(
            f"Argument `initial` must have the shape {x.shape} of the estimated state, but "
            f"got {jnp.shape(initial)}."
        )


def check_observers(observers: Any) -> None:
    """Refuse what is not observers by name."""
    if not isinstance(observers, Mapping):
        kind("observers", observers, Mapping, hint="observers by name, a dictionary")
    for name, observer in observers.items():
        if not isinstance(name, str):
            raise unlike("observers", name, "observers by name, a string")
        what = f"observers[{name!r}]"
        kind(what, observer, AbstractObserver, hint="an observer")


def _between(y0: PyTree, y1: PyTree, theta: Float[Array, ""]) -> PyTree:
    return jax.tree.map(lambda a, b: a + theta.astype(a.dtype) * (b - a), y0, y1)
