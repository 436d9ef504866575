"""The protocol of every observer."""

import abc
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Generic

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import kind, positive
from .._module import Module
from .._signals import check_signals
from .._typing import PyTree
from ..realise import Advance, Flow, Pass, Start, States

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
      is not observable now, shape `()`.
    """

    value: Float[Array, "*batch n"]
    certificate: Float[Array, "*batch"]
    coasting: Bool[Array, "*batch"]


class ObserverState(Module):
    """The state of an observer, a value: save it, restore it, batch it.

    - `states`: every filter and other state, by name;
    - `y`: the last measurement, from which the next sampling interval begins.
    """

    states: States
    y: PyTree


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
    """

    @abc.abstractmethod
    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Est:
        """The observer's equations: a pass `F`, the input `u` and the measurement `y`, to
        an [`Estimate`][] (or a dictionary of them, for observers side by side)."""

    def __call__(self, F: Pass, u: PyTree, y: PyTree) -> Est:
        """[`equations`][], of signals with the shapes that they declare: what each way to
        run them calls, and what an observer calls that is made of others."""
        check_signals(self, type(self).equations, u, y)
        return self.equations(F, u, y)

    def init(self, y: PyTree, u: PyTree | None = None) -> ObserverState:
        """The state at the first measurement `y`. Of `u` only the shape matters, which by
        default is that of y."""
        y = jax.tree.map(jnp.asarray, y)
        return ObserverState(self.allocate(y, u).states, y)

    def allocate(self, y: PyTree, u: PyTree | None = None) -> Start:
        """The pass that allocates the states; it knows the laws they follow."""
        start = Start()
        if u is None:
            shape = getattr(self, "signals", {}).get("u")
            y0 = jnp.zeros(shape, jnp.result_type(float)) if shape is not None else y
            u = jax.tree.map(jnp.zeros_like, y0)
        u = jax.tree.map(jnp.asarray, u)
        self(Pass(start), u, y)
        return start

    def vector_field(
        self, t: Float[Array, ""], state: ObserverState, u: PyTree, y: PyTree
    ) -> ObserverState:
        """The derivative of `state` at time `t` (s); that of its `y` is zero."""
        del t
        flow = Flow(state.states)
        self(Pass(flow), u, y)
        return ObserverState(flow.rates, jax.tree.map(jnp.zeros_like, state.y))

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
        within it. Compile a loop of steps with `eqx.filter_jit`.
        """
        positive("dt", dt, "s")
        u, y = jax.tree.map(jnp.asarray, (u, y))
        interval = jnp.asarray(dt) / max(substeps, 1)
        coefficients = self.allocate(y, u).discretise(interval)
        return self.advance(state, u, y, coefficients, substeps=substeps)

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
        substeps)`, already at hand."""
        if not isinstance(substeps, int) or substeps < 1:
            raise ValueError(
                f"Argument `substeps` must be an integer of at least 1, but got {substeps}."
            )
        left = Flow(state.states)
        self(Pass(left), u, state.y)
        states, drives = left.states, left.drives
        if substeps > 1:

            def piece(at_left, theta):
                right = Advance(at_left[0], at_left[1], coefficients)
                self(Pass(right), u, _between(state.y, y, theta))
                return (right.advanced, right.drives), None

            inner = jnp.arange(1, substeps) / substeps
            (states, drives), _ = jax.lax.scan(piece, (states, drives), inner)
        right = Advance(states, drives, coefficients)
        estimate = self(Pass(right), u, y)
        return ObserverState(right.advanced, y), estimate


def named(
    observers: Mapping[str, AbstractObserver[Est]],
) -> dict[str, AbstractObserver[Est]]:
    """Observers by name, as a dictionary; what is none is left to [`check_observers`][]."""
    return dict(observers) if isinstance(observers, Mapping) else observers


def check_observers(observers: Any) -> None:
    """Refuse what is not observers by name."""
    if not isinstance(observers, Mapping):
        kind("observers", observers, Mapping, hint="observers by name, a dictionary")
    for name, observer in observers.items():
        what = f"observers[{name!r}]"
        kind(what, observer, AbstractObserver, hint="an observer")


def _between(y0: PyTree, y1: PyTree, theta: Float[Array, ""]) -> PyTree:
    return jax.tree.map(lambda a, b: a + theta.astype(a.dtype) * (b - a), y0, y1)
