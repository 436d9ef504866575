"""The Kalman filter of all velocities of a mechanical system some of whose parameters are
unknown."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import optional_real, positive
from .._factored_arrays import covariance, unpacked
from .._guard import Guard
from .._realise import Pass
from .._typing import PyTree
from ..plants import AbstractMechanicalSystem
from ._adaptive import IMPROBABLE, AdaptiveEstimate
from ._base import AbstractObserver
from ._lifted_velocities import (
    check_interval,
    check_system,
    judged,
    law_of,
    motion_of,
    numbers,
    signals_of,
    unknown,
    unwrapped,
    whole,
)
from ._mechanical_filter import MechanicalKalman
from ._motion import PUSH, Motion, leaf_of

HELD = 0.9  # of the first deviation of a parameter: nothing has been found of it


def _each(x: Any) -> Any:
    """One entry for each parameter."""
    return tuple(map(numbers, x)) if isinstance(x, list | tuple) else (numbers(x),)


def _each_or_none(x: Any) -> Any:
    return None if x is None else _each(x)


class AdaptiveVelocities(AbstractObserver[AdaptiveEstimate]):
    """The Kalman filter of all velocities of a mechanical system some of whose parameters
    are not known: a [`LiftedVelocities`][] with these as states beside positions and
    velocities.

    - `system`, `guard` and `interval`: as of [`LiftedVelocities`][]; so are
      `output_deviation` (m, rad), `force_deviation` (N, N m) and `prior` (m/s, rad/s),
      shape `()` or `(n,)`, `input_deviation` (N, N m), shape `()` or `(m,)`, and `initial`
      (m/s, rad/s), shape `(n,)`;
    - `parameters`: the names of the leaves of the system that are not known, numbers or
      arrays, such as `("m1", "damping")`, fields joined by dots. `"push"` is a constant
      force on every coordinate (N, N m), shape `(n,)`, which the system does not have: a
      load, or an offset of the input;
    - `deviations`: for each of them its standard deviation before the log, in its own unit,
      a number or one for each of its entries;
    - `drift`: for each of them its random walk: the deviation after a second (its unit over
      the root of seconds); by default they are constant.

    The estimate is an [`AdaptiveEstimate`][], its parameters one after the other, entry by
    entry, in their own units. It is `held` while the record has told nothing of one of
    them: while that is not known to 90 % of its first deviation. It is flagged as coasting
    while one is found 5 of its deviations away, which is no solution, and as
    [`LiftedVelocities`][] is.

    Velocities are measured, whatever the parameters are, so that each step is linear in
    these but for products with the small errors of the velocities. So there is no bank, and
    no rival solution to be told from. A parameter of whose forces the motion tells nothing
    keeps its first deviation; two of which it tells only a sum, such as a mass and the gain
    of the input, keep that of their difference.

    Source: theory, sections 10 and 11; Ljung 1979, doi:10.1109/TAC.1979.1101943.

    **Raises:** `ValueError` as [`LiftedVelocities`][], for parameters that the system does
    not have, and for deviations or drifts that are not one for each.
    """

    system: AbstractMechanicalSystem
    output_deviation: Float[Array, "*n"] = eqx.field(converter=numbers)
    input_deviation: Float[Array, "*m"] = eqx.field(converter=numbers)
    parameters: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    deviations: tuple[Float[Array, "..."], ...] = eqx.field(converter=_each)
    drift: tuple[Float[Array, "..."], ...] | None = eqx.field(
        converter=_each_or_none, default=None
    )
    force_deviation: Float[Array, "*n"] | None = eqx.field(converter=numbers, default=None)
    prior: Float[Array, "*n"] | None = eqx.field(converter=numbers, default=None)
    initial: Float[Array, " n"] | None = eqx.field(converter=numbers, default=None)
    guard: Guard | None = eqx.field(default_factory=lambda: Guard(0.9))
    interval: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        check_system(self)
        names = self.parameters
        if not names or len(set(names)) < len(names):
            raise ValueError(
                "Argument `parameters` must name leaves of the system, each once, but got "
                f"{names!r}."
            )
        for name in names:
            leaf = 0.0 if name == PUSH else leaf_of(self.system, name)
            if type(leaf) is object:
                return  # a placeholder of a tree transformation
            if not isinstance(leaf, jax.Array | float):
                raise ValueError(
                    "Argument `parameters` must name arrays that the system has, or "
                    f'"{PUSH}", but `{name}` is none of {type(self.system).__name__}.'
                )
        for what in ("deviations", "drift"):
            each = getattr(self, what)
            if each is None:
                continue
            if len(each) != len(names):
                raise ValueError(
                    f"Argument `{what}` must have one entry for each of {names!r}, but has "
                    f"{len(each)}."
                )
            for value in each:
                positive(what, value)

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return signals_of(self.system)

    def continued(self, before: PyTree, y: PyTree) -> Any:
        return unwrapped(self.system, before, y)

    def law(self, u: Float[Array, " m"], y: Float[Array, " n"]) -> MechanicalKalman:
        """The filter itself, for signals like u and y."""
        motion = motion_of(self, y, self.parameters)
        deviations = _flat("deviations", motion, self.deviations, y)
        drift = None if self.drift is None else _flat("drift", motion, self.drift, y)
        return law_of(self, motion, deviations, drift, u, y)

    def vector_field(self, t: Any, state: Any, u: PyTree, y: PyTree) -> Any:
        check_interval(self.interval)
        return super().vector_field(t, state, u, y)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> AdaptiveEstimate:
        n, law = y.shape[0], self.law(u, y)
        value, certificate, flagged, P, belief = judged(F, law, u, y)
        U = unpacked(belief.factors)[2 * n :]
        found, Q = belief.mean[2 * n :], covariance(U, belief.factors.pivots)
        first = law.deviations.parameters
        off = jnp.abs(found - law.motion.nominal(y.dtype))
        improbable = jnp.any(off > IMPROBABLE * first)
        return AdaptiveEstimate(
            value,
            certificate,
            flagged | improbable | unknown(self.guard, certificate),
            P,
            parameters=found,
            parameter_covariance=Q,
            held=jnp.any(jnp.diagonal(Q) > (HELD * first) ** 2),
        )


def _flat(
    what: str, motion: Motion, each: tuple[Array, ...], like: Array
) -> Float[Array, " k"]:
    """One number for each entry of the parameters of a motion, one after the other."""
    leaves = [jnp.asarray(motion.leaf(name), like.dtype) for name in motion.parameters]
    pairs = zip(each, leaves, strict=True)
    return jnp.concatenate([whole(what, value, leaf).ravel() for value, leaf in pairs])
