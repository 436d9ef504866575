"""What a model predicts along a log: states carried along their known derivative, and the
gap of the equation that they should satisfy at every sample."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._derive.plant import ModelPlant
from ..._module import Module
from ..._relations import AbstractTerms, Quadratic, Rate
from ..._runge_kutta import runge_kutta
from ..._typing import RealArray
from ...observers import AlgebraicObserver, Asymptotic, BearingObserver, SideBySide
from ...plants import (
    WRIM,
    AbstractMechanicalSystem,
    MechanicalState,
    SalientFluxRelation,
)
from .corrected import Corrected

Relation = Callable[[Any, Any], AbstractTerms]


REGULAR = 1e6  # of a condition number, at most


class Turn(NamedTuple):
    """About an interval, `u`: the slope of the inputs from the interval before to the one
    after (their units per second), shape `(m,)`, and `y`: that of the slope of the outputs
    (their units per second squared), shape `(p,)`; or about many."""

    u: Any
    y: Any


def turns(
    h: Float[Array | np.ndarray, " i"],
    u: Float[Array | np.ndarray, "N m"],
    y: Float[Array | np.ndarray, "N p"],
) -> Turn:
    """Of every interval of a log, shapes `(N - 1, m)` and `(N - 1, p)`."""

    xp = np if isinstance(u, np.ndarray) else jnp

    def across(x):
        ends = xp.concatenate([x[:1], x, x[-1:]])
        return ends[2:] - ends[:-2]

    width = xp.concatenate([h[:1], h, h[-1:]])
    width = (0.5 * (width[2:] + width[:-2]) + width[1:-1])[:, None]
    return Turn(across(u[:-1]) / width, across((y[1:] - y[:-1]) / h[:, None]) / width)


class AbstractPrediction(Module):
    """`x' = drift(x, u, y)` with `gap(x, u, y) = 0` for the true x and y."""

    @abc.abstractmethod
    def drift(
        self, x: Float[Array, " n"], u: Float[Array, " m"], y: Float[Array, " p"]
    ) -> Float[Array, " n"]:
        """The known derivative of x (units of x per second)."""

    @abc.abstractmethod
    def gap(
        self, x: Float[Array, " n"], u: Float[Array, " m"], y: Float[Array, " p"]
    ) -> Float[Array, " g"]:
        """How far the equations are from holding, in any units: their size cancels."""

    @abc.abstractmethod
    def step(
        self,
        x: Float[Array, " n"],
        disturbance: Float[Array, " w"],
        u: Float[Array, " m"],
        y: tuple[Float[Array, " p"], Float[Array, " p"]],
        h: Float[Array, ""],
    ) -> Float[Array, " n"]:
        """x after `h` seconds, with u held, y on a line between two values, and
        `disturbance` added to the derivatives that it enters."""

    @abc.abstractmethod
    def bend(
        self,
        h: Float[Array, ""],
        u: Float[Array, " m"],
        y: Float[Array, " p"],
        turn: "Turn",
    ) -> Float[Array, " p"]:
        """The mean of y over an interval less that of its two ends."""

    @property
    @abc.abstractmethod
    def disturbed(self) -> tuple[int, ...]:
        """The entries of x whose derivatives are disturbed."""


class RelationPrediction(AbstractPrediction):
    """One relation or several: their states one after the other, each with a gap.

    A linear or quadratic relation is its own gap. That of a rate relation is the measured s
    less its own prediction, which is one more state: nothing is differentiated.

    - `constants`: of each relation, what its d is wrong by, shape `(relations,)`;
    - `sizes`: of the states of each; `rates`: whether it is a rate relation;
    - `held`: one where the inputs are held between the samples, zero where they vary as
      smoothly as the outputs do; `None` where it says nothing of the outputs.
    """

    relations: tuple[Relation, ...]
    constants: Float[Array, " relations"]
    held: Float[Array, ""] | None
    sizes: tuple[int, ...] = eqx.field(static=True)
    rates: tuple[bool, ...] = eqx.field(static=True)

    def _parts(self, x):
        start = 0
        for size in self.sizes:
            yield x[start : start + size]
            start += size

    def drift(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        found = []
        for relation, part, rate in zip(
            self.relations, self._parts(x), self.rates, strict=True
        ):
            terms = relation(u, y)
            hidden = part[:-1] if rate else part
            found.append(terms.drift(hidden))
            if isinstance(terms, Rate):
                given = jnp.sum(terms.c * hidden) - (0.0 if terms.d is None else terms.d)
                found.append(given[None])
        return jnp.concatenate(found)

    def step(
        self,
        x: RealArray,
        disturbance: RealArray,
        u: RealArray,
        y: tuple[RealArray, RealArray],
        h: RealArray,
    ) -> RealArray:
        # Heun's method, exact where the known derivative does not depend on x.
        added = jnp.zeros_like(x).at[jnp.asarray(self.disturbed)].add(disturbance)
        left = self.drift(x, u, y[0]) + added
        right = self.drift(x + h * left, u, y[1]) + added
        return x + 0.5 * h * (left + right)

    def gap(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        found = []
        for relation, part, constant in zip(
            self.relations, self._parts(x), self.constants, strict=True
        ):
            terms = relation(u, y)
            if isinstance(terms, Rate):
                found.append(terms.s - part[-1] - constant)
            else:
                found.append(residual(terms, part)[0] - constant)
        return jnp.stack(found)

    def bend(self, h: RealArray, u: RealArray, y: RealArray, turn: "Turn") -> RealArray:
        # A parabola of curvature y'' has -h^2 y''/12 more in the mean than its chord. With
        # smooth inputs y'' is that of the samples. An input that is held lacks its slope,
        # and y'' what that makes: of a motor u'/L.
        curvature = turn.y
        if self.held is not None:
            curvature = curvature - self.held * answer(self.relations[0], u, y, turn.u)
        return -(h**2) * curvature / 12.0

    @property
    def disturbed(self) -> tuple[int, ...]:
        entries, start = [], 0
        for size, rate in zip(self.sizes, self.rates, strict=True):
            entries += range(start, start + size - rate)
            start += size
        return tuple(entries)


def answers(
    relation: Relation, u: Float[np.ndarray, "N m"], y: Float[np.ndarray, "N p"]
) -> bool:
    """Whether the derivatives of the outputs follow the inputs of a log at once."""
    terms = jax.eval_shape(relation, u[0], y[0])
    if not (isinstance(terms, Quadratic) and terms.z.shape == y[0].shape == u[0].shape):
        return False
    return bool(np.all(np.linalg.cond(np.asarray(_slopes(relation, u, y))) < REGULAR))


@eqx.filter_jit
def _slopes(relation, u, y):
    return jax.vmap(jax.jacfwd(lambda y, u: _linear(relation, u, y)))(y, u)


def _linear(relation: Relation, u: Any, y: Any) -> Array:
    terms: Any = relation(u, y)
    return terms.c


def answer(
    relation: Relation, u: Float[Array, " n"], y: Float[Array, " n"], jump: RealArray
) -> Float[Array, " n"]:
    """By how much y' jumps where u jumps (their units).

    With `1/2 x'Q x = c'x + d`, of a motor `Q x - c` is the flux of its magnet over its
    inductance, which goes on as before, so that `(dc/dy) y'` jumps as `Q z` does. Of other
    relations that is the size of the jump."""
    terms: Any = relation(u, y)
    _, moved = jax.jvp(lambda u: relation(u, y).z, (u,), (jump,))
    slope = jax.jacfwd(lambda y: _linear(relation, u, y))(y)
    return jnp.linalg.solve(slope, terms.times(moved))


def residual(terms: Any, x: Float[Array, " n"]) -> tuple[Array, Array]:
    """`1/2 x'Q x - c'x - d` of a quadratic relation, `c'x - d` of a linear one, and its
    gradient in x."""
    if isinstance(terms, Quadratic):
        Qx = terms.times(x)
        return 0.5 * jnp.sum(x * Qx) - jnp.sum(terms.c * x) - terms.d, Qx - terms.c
    return jnp.sum(terms.c * x) - terms.d, terms.c


class NewtonPrediction(AbstractPrediction):
    """A mechanical system: x is its coordinates and velocities, the gap what is measured
    of the former less what is predicted: the acceleration residual without a derivative.

    - `parts`: steps of the solver in each interval, more of them for a fast decay."""

    system: AbstractMechanicalSystem
    coordinates: int = eqx.field(static=True)
    parts: int = eqx.field(static=True, default=1)

    def drift(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        del y
        n = self.coordinates
        state = MechanicalState(x[:n], x[n:])
        rate = self.system.vector_field(jnp.zeros(()), state, u)
        return jnp.concatenate([rate.position, rate.velocity])

    def step(
        self,
        x: RealArray,
        disturbance: RealArray,
        u: RealArray,
        y: tuple[RealArray, RealArray],
        h: RealArray,
    ) -> RealArray:
        added = jnp.zeros_like(x).at[jnp.asarray(self.disturbed)].add(disturbance)
        rate = lambda t, x: self.drift(x, u, y[0]) + added
        step = lambda k, x: runge_kutta(rate, jnp.zeros_like(h), x, h / self.parts)
        # A loop, since XLA would compile every step for itself.
        return jax.lax.fori_loop(0, self.parts, step, x) if self.parts > 1 else step(0, x)

    def gap(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        del u
        return y - x[: self.coordinates]

    def bend(self, h: RealArray, u: RealArray, y: RealArray, turn: "Turn") -> RealArray:
        del h, u, turn
        return jnp.zeros_like(y)  # the measured y does not enter the derivatives

    @property
    def disturbed(self) -> tuple[int, ...]:
        return tuple(range(self.coordinates, 2 * self.coordinates))


class ModelPrediction(AbstractPrediction):
    """A model as a plant: x is its state, as a vector, the gap what is measured less what
    is predicted. What does not change, an unknown parameter, is not disturbed.

    - `parts`: steps of the solver in each interval."""

    plant: ModelPlant
    parts: int = eqx.field(static=True, default=1)

    def drift(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        del y
        return self.plant.drift(x, u)

    def step(
        self,
        x: RealArray,
        disturbance: RealArray,
        u: RealArray,
        y: tuple[RealArray, RealArray],
        h: RealArray,
    ) -> RealArray:
        del y
        added = jnp.zeros_like(x).at[jnp.asarray(self.disturbed)].add(disturbance)
        rate = lambda t, x: self.plant.drift(x, u) + added
        step = lambda k, x: runge_kutta(rate, jnp.zeros_like(h), x, h / self.parts)
        return jax.lax.fori_loop(0, self.parts, step, x) if self.parts > 1 else step(0, x)

    def gap(self, x: RealArray, u: RealArray, y: RealArray) -> RealArray:
        return y - self.plant.measured(x, u)

    def bend(self, h: RealArray, u: RealArray, y: RealArray, turn: "Turn") -> RealArray:
        del h, u, turn
        return jnp.zeros_like(y)

    @property
    def disturbed(self) -> tuple[int, ...]:
        code = self.plant.code
        unknown = code.derived.model.unknown
        return tuple(k for k, name in enumerate(code.names) if name not in unknown)


def observers_of(model: Any) -> tuple[AlgebraicObserver, ...] | None:
    """The algebraic observers in an observer, `None` where it is not one."""
    match model:
        case AlgebraicObserver():
            return (model,)
        case Asymptotic():
            return observers_of(model.observer)
        case BearingObserver(flux=AlgebraicObserver() as flux):
            return (flux,)
        case SideBySide():
            inner = [observers_of(part) for part in model.observers.values()]
            if all(part is not None for part in inner):
                return tuple(o for part in inner if part is not None for o in part)
    return None


def relations_of(model: Any) -> tuple[Relation, ...] | None:
    """The relations of an observer or a plant, `None` where it has none."""
    observers = observers_of(model)
    if observers is not None:
        return tuple(observer.relation for observer in observers)
    if isinstance(model, WRIM):
        return model.flux_relation("stator"), model.flux_relation("rotor")
    if hasattr(model, "flux_relation"):
        return (model.flux_relation(),)
    return None


def open_constant(relation: Relation) -> Array | None:
    """What a relation's d lacks: the magnet flux, of which the observer needs nothing. It
    is `None` for a relation that is complete."""
    while isinstance(relation, Corrected):
        relation = relation.relation
    if isinstance(relation, SalientFluxRelation):
        return jnp.zeros(())
    magnet_flux = getattr(relation, "magnet_flux", None)
    return None if magnet_flux is None else jnp.asarray(magnet_flux)
