"""Velocities of a mechanical system from its positions."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import is_concrete, optional_real
from .._completions import Repeat
from .._filters import AbstractFilter, LowPass
from .._module import Module
from .._realise import Pass
from .._relations import Rate
from .._structure import Friction, Structure, decay_rate, structure_of
from .._typing import PyTree
from ..plants import AbstractMechanicalSystem
from ._algebraic import AlgebraicObserver
from ._asymptotic import Asymptotic
from ._base import AbstractObserver, Estimate
from ._unwrapped import Unwrapped

__all__ = [
    "CoordinateVelocity",
    "MomentumRelation",
    "Velocities",
    "VelocityObserver",
    "velocity_observer",
]


class MomentumRelation(Module):
    """The rate relation of one coordinate's momentum. With the inertia `m(q)` of coordinate
    j and its generalised force f, friction not included,

    - no or constant friction R, which integrates: `x = m q_j' + (R q)_j`, `x' = f`,
      `x/m = q_j' + (R q)_j/m`;
    - friction r(q) that varies with position: `x = m q_j'`, `x' = -(r/m) x + f`. Its filter
      must be faster than `r/m` (1/s).

    - `system`: the mechanical system; `coordinate`: j, counted from 0;
    - `friction`: `"none"`, `"constant"` or `"varying"`, as it is above;
    - `constant`: whether the inertia m does not depend on q.

    `relation(u, (q, velocity))` needs the velocities that f depends on, those of the
    coordinates whose inertia depends on this one; the other entries do not matter.

    Source: paper, Props 4 and 5 and section 4.3; theory, section 5.
    """

    system: AbstractMechanicalSystem
    coordinate: int = eqx.field(static=True)
    friction: Friction = eqx.field(static=True, default="none")
    constant: bool = eqx.field(static=True, default=False)

    def __call__(self, u: Float[Array, " m"], y: PyTree) -> Rate:
        q, velocity = y
        j, m = self.coordinate, self._inertia(q)
        varying = self.friction == "varying"
        decay = self.system.friction(q)[j, j] / m
        return Rate(
            c=(1.0 / m)[None],
            s=q[j],
            z=self.system.force(q, velocity, u)[j][None],
            d=self._integrated_friction(q) / m if self.friction == "constant" else None,
            A=-decay[None, None] if varying else None,
            constant=self.constant and not varying,
        )

    def _inertia(self, q: Float[Array, " n"]) -> Float[Array, ""]:
        return self.system.inertia(q)[self.coordinate, self.coordinate]

    def _integrated_friction(self, q: Float[Array, " n"]) -> Float[Array, ""]:
        if self.friction != "constant":
            return jnp.zeros_like(q[0])
        return jnp.sum(self.system.friction(q)[self.coordinate] * q)

    def velocity(self, x: Float[Array, " 1"], q: Float[Array, " n"]) -> Float[Array, " 1"]:
        """The velocity (m/s or rad/s) from x."""
        return (x - self._integrated_friction(q)) / self._inertia(q)

    def momentum(
        self, velocity: Float[Array, ""], q: Float[Array, " n"]
    ) -> Float[Array, " 1"]:
        """x from the velocity."""
        return (self._inertia(q) * velocity + self._integrated_friction(q))[None]


class CoordinateVelocity(AbstractObserver):
    """The velocity of one coordinate, shape `(1,)`, from `y = (q, velocity)`, where
    `velocity` holds those that it needs.

    - `observer`: of x of a [`MomentumRelation`][], algebraic or asymptotic;
    - `initial`: the velocity before the first certified instant (rad/s or m/s).
    """

    observer: AlgebraicObserver | Asymptotic
    initial: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)

    @property
    def relation(self) -> MomentumRelation:
        inner = self.observer
        relation = (inner.observer if isinstance(inner, Asymptotic) else inner).relation
        assert isinstance(relation, MomentumRelation)
        return relation

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        q, _ = y
        guess = 0.0 * q[0] if self.initial is None else self.initial
        start = self.relation.momentum(guess, q)
        observer = _starting_at(self.observer, start, keep=self.initial is not None)
        x = observer(F, u, y)
        value = self.relation.velocity(x.value, q)
        return Estimate(value, x.certificate, x.coasting)


def _starting_at(observer, start, keep):
    if isinstance(observer, Asymptotic):
        inner = _starting_at(observer.observer, start, keep)
        return Asymptotic(inner, observer.gain, start if keep else None)
    return dataclasses.replace(observer, initial=start)


class Velocities(AbstractObserver[dict[str, Estimate]]):
    """The velocities of all coordinates from `y = q`, as a dictionary with one estimate,
    of shape `(1,)`, for each: `qdot1`, `qdot2`, and so on.

    - `parts`: the observer of each coordinate; `stages`: their order, since later ones are
      fed the velocities of earlier ones.

    A velocity is worth no more than those that it is found from: its certificate is at most
    theirs, and it coasts if one of them does.
    """

    parts: tuple[CoordinateVelocity, ...]
    stages: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.parts[0].relation.system.signals_of(len(self.parts))

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> dict[str, Estimate]:
        found: dict[int, Estimate] = {}
        velocity = jnp.zeros_like(y)
        certificate, coasting = jnp.asarray(jnp.inf, y.dtype), jnp.asarray(False)
        for stage in self.stages:
            for j in stage:
                e = self.parts[j](F.scope(f"q{j + 1}"), u, (y, velocity))
                found[j] = Estimate(
                    e.value, jnp.minimum(e.certificate, certificate), e.coasting | coasting
                )
            for j in stage:
                velocity = velocity.at[j].set(found[j].value[0])
                certificate = jnp.minimum(certificate, found[j].certificate)
                coasting = coasting | found[j].coasting
        return {f"qdot{j + 1}": found[j] for j in sorted(found)}


class VelocityObserver(AbstractObserver):
    """The velocities of all coordinates from `y = q`, shape `(n,)`; [`velocity_observer`][]
    makes one for a system.

    Its certificate is the least one of the coordinates, and it coasts if any of them does.
    `velocities` is the same observer with an estimate for each coordinate.
    """

    velocities: Velocities

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.velocities.signals

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> Estimate:
        each = list(self.velocities(F, u, y).values())
        value = jnp.concatenate([e.value for e in each])
        certificate = jnp.min(jnp.stack([e.certificate for e in each]))
        return Estimate(value, certificate, jnp.any(jnp.stack([e.coasting for e in each])))


def velocity_observer(
    system: AbstractMechanicalSystem,
    filter: AbstractFilter,
    *,
    gain: Float[Array, ""] | float | None = None,
    initial: Any = None,
    region: tuple[Any, Any] | None = None,
    form: Structure | None = None,
    **settings: Any,
) -> AbstractObserver:
    """Design the algebraic observer of the velocities of `system` from its positions.

    It decides whether the system is of the class (see [`structure_of`][]), derives
    integrating factors, relations and stages, and returns a [`VelocityObserver`][]. Angles
    are unwrapped on the way in where the system has any ([`Unwrapped`][]).

    - `filter`: of every coordinate;
    - `gain` (rad/s): makes each an A-ASLO of the momentum, `x' = f - gain (x -
      x_algebraic)`; by default none;
    - `initial`: the velocities before the first certified instant, shape `(n,)`; zero by
      default;
    - `region`: where the system moves, a pair (low, high) of coordinates;
    - `form`: its [`Structure`][], where that is known already, or while parameters are
      traced;
    - `settings`: `completion`, `guard` and `start` of [`AlgebraicObserver`][]; here the
      completion is `Repeat()` by default, which with one unknown is the row itself.

    **Raises:** [`StructureError`][] where the system is not of the class; `ValueError`
    where a low-pass filter is not faster than friction that varies with position, on
    `region`.

    Source: paper, section 4; theory, section 5.
    """
    if form is None:
        form = structure_of(system, region)
    n = len(form.friction)
    guesses = [None] * n if initial is None else list(jnp.asarray(initial, float))
    if len(guesses) != n:
        raise ValueError(
            f"Argument `initial` must have one velocity for each of the {n} coordinates, "
            f"but got {len(guesses)}."
        )
    if "varying" in form.friction:
        _check_rate(system, filter, form, region)
    settings = {"completion": Repeat()} | settings
    parts = []
    for j, guess in enumerate(guesses):
        relation = MomentumRelation(system, j, form.friction[j], form.constant[j])
        observer = AlgebraicObserver(relation, filter, **settings)
        whole = observer if gain is None else Asymptotic(observer, gain)
        parts.append(CoordinateVelocity(whole, guess))
    found = VelocityObserver(Velocities(tuple(parts), form.stages))
    return Unwrapped(found, system.angles) if any(system.angles) else found


def _check_rate(
    system: AbstractMechanicalSystem, filter: AbstractFilter, form: Structure, region: Any
) -> None:
    """Refuse a low-pass filter that is not faster than varying friction decays."""
    known = is_concrete(*jax.tree.leaves((system, filter)))
    if not isinstance(filter, LowPass) or not known:
        return
    for j, kind in enumerate(form.friction):
        if kind != "varying":
            continue
        q, decay = decay_rate(system, j, region)
        k = int(decay.argmax())
        rate = float(filter.slowest)
        if not rate > decay[k]:
            raise ValueError(
                f"Argument `filter` must have a rate above the friction of q{j + 1} over "
                f"its inertia, {decay[k]:.4g} 1/s at q = {q[k].round(3).tolist()}, where "
                f"friction varies with position, but its rate is {rate:.4g} rad/s."
            )
