"""A calibration as a problem of least squares: what is unknown, and where it starts."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._derive.certificate import USELESS, typical_cutoff
from ..._derive.plant import ModelPlant
from ..._filters import LowPass
from ..._module import Module
from ..._relations import Rate
from ..._replay import replay
from ...observers import Unwrapped, VelocityObserver
from ...plants import AbstractMechanicalSystem
from . import start
from .imperfections import seen, sizes_of
from .parameters import Parameters
from .predict import (
    AbstractPrediction,
    ModelPrediction,
    NewtonPrediction,
    RelationPrediction,
    answers,
    open_constant,
    relations_of,
    residual,
)
from .relative import Observers, trusted
from .whiten import Signals

HELD = 0.5  # of inputs, as far as one knows, and how unsure that is: held or smooth
STEP, PARTS = 0.25, 32  # of a time constant, of the solver at most; and steps at most
NEAR = 3.0  # half widths of a range about its middle, in which an estimate is plausible
SETTLING = 2.0  # time constants after which one is
SLOPE = 20  # rows from which the first velocities of a mechanical system are guessed


class Unobservable(ValueError):
    """A record that shows nothing of its states, so that it says nothing of parameters."""


Vector = Array | np.ndarray


class Form(Module):
    """How a model predicts: a mechanical system, or relations with what is known of them.

    - `sizes`, `rates`: as in [`RelationPrediction`][]; `opened`: which constants are free;
    - `answers`: whether outputs answer a held input at once, so that it bends them;
    - `parts`: as in [`NewtonPrediction`][]; `modelled`: whether the model is a plant with
      all of its states, as [`ModelPrediction`][] has it.
    """

    coordinates: int = eqx.field(static=True, default=0)
    parts: int = eqx.field(static=True, default=1)
    sizes: tuple[int, ...] = eqx.field(static=True, default=())
    rates: tuple[bool, ...] = eqx.field(static=True, default=())
    opened: tuple[bool, ...] = eqx.field(static=True, default=())
    answers: bool = eqx.field(static=True, default=False)
    modelled: bool = eqx.field(static=True, default=False)

    def prediction(self, model: Any, rest: Vector) -> AbstractPrediction:
        """Of the `model`, with the values of its free constants, and, where the outputs
        answer at once, of how far the inputs are held."""
        if self.coordinates:
            return NewtonPrediction(model, self.coordinates, self.parts)
        if self.modelled:
            return ModelPrediction(model, self.parts)
        relations = relations_of(model)
        assert relations is not None
        free = np.flatnonzero(self.opened)
        every = jnp.zeros(len(relations)).at[free].set(rest[: free.size])
        held = jnp.asarray(rest)[-1] if self.answers else None
        return RelationPrediction(relations, every, held, self.sizes, self.rates)


class Problem(Module):
    """The unknowns are the parameters `q`, the first states, the free constants, and,
    where the form `answers`, how far the inputs are held.

    `unknowns` is where they start, one vector in this order. The last `tested` parameters
    stay there: of them only slopes are asked for.
    """

    parameters: Parameters
    form: Form
    signals: Signals
    unknowns: Float[np.ndarray, " v"]
    states: int = eqx.field(static=True)
    tested: int = eqx.field(static=True)

    @property
    def found(self) -> tuple[str, ...]:
        """The names of the parameters that are to be found."""
        return self.parameters.names[: len(self.parameters.names) - self.tested]

    def recorded(self, v: Vector) -> Any:
        """The model and the errors of the record ([`Recorded`][]) of unknowns."""
        return self.parameters.place(v[: len(self.parameters.names)])

    def prediction(self, v: Vector) -> tuple[AbstractPrediction, Any, Signals]:
        """What is predicted with the unknowns `v`, from which states on, and of which
        signals."""
        prediction, x0, recorded = predicted(self.parameters, self.form, self.states, v)
        return prediction, x0, recorded.imperfections(self.signals)

    def drift(self) -> Float[np.ndarray, "N n"]:
        """The derivatives of the states at their start (their units per second)."""
        return np.asarray(_drift(self, self.unknowns))


def predicted(
    parameters: Parameters, form: Form, states: int, v: Vector
) -> tuple[AbstractPrediction, Any, Any]:
    """What is predicted with the unknowns `v`, from which of its `states` on, and the model
    with the errors of the record ([`Recorded`][])."""
    k = len(parameters.names)
    recorded = parameters.place(v[:k])
    prediction = form.prediction(recorded.model, v[k + states :])
    return prediction, v[k : k + states], recorded


# What runs once is compiled as a whole: operation by operation XLA makes a program of each.
@eqx.filter_jit
def _gaps(relation, x, u, y):
    return jax.vmap(lambda x, u, y: residual(relation(u, y), x)[0])(x, u, y)


@eqx.filter_jit
def _drift(problem, v):
    prediction, x0, signals = problem.prediction(v)
    return jax.vmap(lambda u, y: prediction.drift(x0, u, y))(signals.u, signals.y)


def problem_of(
    parameters: Parameters,
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N m"],
    y: Float[np.ndarray, "N p"],
    cutoff: float | None,
    constant: bool | None,
    scale: Mapping[str, float],
    tested: int,
) -> Problem:
    """The problem of a log, with a first guess of all that is unknown."""
    model = parameters.model.model
    for name in scale:
        if name not in parameters.names:
            raise ValueError(
                f"Argument `scale` must name parameters among {', '.join(parameters.names)}"
                f", but got `{name}`."
            )
    if isinstance(model, AbstractMechanicalSystem):
        return _mechanical(parameters, t, u, y, scale, tested)
    if isinstance(model, ModelPlant):
        return _modelled(parameters, t, u, y, cutoff, scale, tested)
    relations = relations_of(model)
    if relations is None:
        system = isinstance(model, Unwrapped | VelocityObserver)
        remedy = (
            "pass the mechanical system itself, whose parameters its coordinates share"
            if system
            else "pass an observer or a plant with a relation, or a mechanical system"
        )
        raise ValueError(
            f"Argument `model` must have a relation, but got {type(model).__name__}; "
            f"{remedy}."
        )
    return _related(parameters, relations, t, u, y, cutoff, constant, scale, tested)


def _mechanical(parameters, t, u, y, scale, tested):
    system = parameters.model.model
    if any(system.angles):
        y = np.where(system.angles, np.unwrap(y, axis=0), y)
    rows = min(SLOPE, t.size)
    slope = np.polyfit(t[:rows] - t[0], y[:rows], 1)[0]
    signals = Signals(np.diff(t), u, y)
    n = y.shape[1]
    x = np.concatenate([y, np.gradient(y, t, axis=0)], axis=1)
    form = Form(coordinates=n, parts=_parts(system, signals, np.concatenate([y[0], slope])))
    parameters = _scaled(parameters, form, signals, x, np.zeros(0), scale)
    unknowns = np.concatenate([np.zeros(len(parameters.names)), y[0], slope])
    return Problem(parameters, form, signals, unknowns, 2 * n, tested)


def _modelled(parameters, t, u, y, cutoff, scale, tested):
    plant, signals = parameters.model.model, Signals(np.diff(t), u, y)
    derived, names = plant.code.derived, plant.code.names
    low = derived.slowest
    if cutoff is None:
        cutoff = typical_cutoff(derived.model, low)
    elif not cutoff > low:
        raise ValueError(
            f"Argument `cutoff` must be above {low:.4g} rad/s, by the fastest mode of the "
            f"model, but got {cutoff:.4g}."
        )
    observer = derived.observer(LowPass(cutoff), guard=None)
    estimate = replay(observer, t, u, y, engine="auto")
    known = _trusted_states(derived, estimate, t, cutoff)
    k = int(np.argmax(known))
    x = np.tile(np.asarray(plant.vector(plant.initial())), (t.size, 1))
    for j, name in enumerate(derived.states):
        x[:, names.index(name)] = np.asarray(estimate.value)[:, j]
    for j, place in enumerate(plant.code.moving):
        x[:, len(plant.code.states) + j] = y[:, place]
    signals, x = Signals(*(each[k:] for each in signals)), x[k:]
    slopes = jax.jit(jax.jacfwd(plant.drift))(jnp.asarray(x[0]), jnp.asarray(u[k]))
    fastest = float(np.max(np.abs(np.linalg.eigvals(np.asarray(slopes))), initial=0.0))
    parts = _steps(fastest, signals.h)
    form = Form(modelled=True, parts=parts)
    parameters = _scaled(parameters, form, signals, x, np.zeros(0), scale)
    unknowns = np.concatenate([np.zeros(len(parameters.names)), x[0]])
    return Problem(parameters, form, signals, unknowns, x.shape[1], tested)


def _trusted_states(derived, estimate, t, cutoff):
    """The rows whose estimates are certified, and within the ranges of the model."""
    value = np.asarray(estimate.value)
    ranges = [derived.model.ranges[name] for name in derived.states]
    middle = np.array([0.5 * (low + high) for low, high in ranges])
    half = np.array([0.5 * (high - low) for low, high in ranges])
    near = (np.abs(value - middle) < NEAR * half).all(axis=1)
    late = t - t[0] > SETTLING / cutoff
    found = (np.asarray(estimate.certificate) > USELESS) & near & late
    if not found.any():
        raise Unobservable(
            f"No calibration: in {t[-1] - t[0]:.3g} s of the log no estimate of "
            f"{', '.join(derived.states)} is certified and near its range; record a longer "
            "run, in which inputs and outputs vary, or choose another `cutoff`."
        )
    return found


def _steps(fastest, h):
    """Of the solver in an interval, for a mode as fast as that (1/s)."""
    return int(np.clip(np.ceil(fastest * float(np.quantile(h, 0.99)) / STEP), 1, PARTS))


def _parts(system, signals, x):
    """How many steps an interval takes whose error is that of a decay in steps of at most a
    quarter of its time constant, twice as fast as at the start."""
    h, u, _ = signals
    n = x.size // 2
    field = lambda x: system.acceleration(x[:n], x[n:], jnp.asarray(u[0]))
    slopes = np.asarray(jax.jacfwd(field)(jnp.asarray(x)))
    fastest = float(np.max(np.abs(np.linalg.eigvals(slopes[:, n:]))))
    return _steps(fastest, h)


def _related(parameters, relations, t, u, y, cutoff, constant, scale, tested):
    terms = [jax.eval_shape(r, u[0], y[0]) for r in relations]
    rates = tuple(isinstance(term, Rate) for term in terms)
    opened = tuple(
        not rate and (_opened(parameters, j) if constant is None else constant)
        for j, rate in enumerate(rates)
    )
    whole = Signals(np.diff(t), u, y)
    if cutoff is None:
        cutoff = start.typical_cutoff(relations, whole)
    observers = Observers(cutoff)
    sizes = tuple(term.z.shape[0] + rate for term, rate in zip(terms, rates, strict=True))
    at_once = len(relations) == 1 and answers(relations[0], u, y)
    form = Form(sizes=sizes, rates=rates, opened=opened, answers=at_once)
    held = np.full(int(at_once), HELD)
    begun = observers(parameters.model.model)
    estimates = [replay(o, t, u, y, engine="auto") for o in begun]
    _certified(estimates, begun, t)
    x = np.concatenate(
        [_states(e.value, y, r) for e, r in zip(estimates, rates, strict=True)], axis=1
    )
    parameters = _scaled(
        parameters, form, whole, x, np.zeros(sum(opened) + held.size), scale
    )
    q = start.first_guess(parameters, observers, t, whole, opened, tested)
    recorded = parameters.place(q)
    found = observers(recorded.model)
    _, u, y = seen(parameters, whole, q)[0]
    estimates = [replay(o, t, u, y, engine="auto") for o in found]
    weights, certified = _certified(estimates, found, t)
    if certified.sum() < 0.1 * t.size:
        raise Unobservable(
            "No calibration: the algebraic estimates are certified in "
            f"{100 * certified.mean():.2g} % of the rows of the log, but a tenth is "
            "needed; record a run in motion, or choose another `cutoff`."
        )
    k = int(np.argmax(certified))
    signals = Signals(*(x[k:] for x in whole))
    first, constants = [], []
    for relation, estimate, w, rate, is_open in zip(
        [o.relation for o in found], estimates, weights, rates, opened, strict=True
    ):
        first.append(np.asarray(estimate.value)[k])
        if rate:
            terms_there: Any = relation(u[k], y[k])
            first.append(np.asarray(terms_there.s)[None])
        if is_open:
            gaps = np.asarray(_gaps(relation, estimate.value, u, y))
            constants.append([np.sum(w * gaps) / np.sum(w)])
    unknowns = np.concatenate([q, *first, *constants, held])
    return Problem(parameters, form, signals, unknowns, sum(sizes), tested)


def _certified(estimates, observers, t):
    """The weights of the rows of each estimate, and the rows that all of them certify."""
    weights = [trusted(e, t, o) for e, o in zip(estimates, observers, strict=True)]
    certified = np.all([w > 0 for w in weights], axis=0)
    if not certified.any():
        raise Unobservable(
            f"No calibration: in {t[-1] - t[0]:.3g} s of the log no algebraic estimate is "
            "certified for longer than two time constants of its filter; record a longer "
            "run, in motion, or choose another `cutoff`."
        )
    return weights, certified


def _states(value, y, rate):
    return np.concatenate([value, y[:, :1]], 1) if rate else np.asarray(value)


def _opened(parameters: Parameters, j: int) -> bool:
    """Whether the constant of relation `j` is unknown and no parameter stands for it."""

    def constant(q):
        relations = relations_of(parameters.place(q).model)
        assert relations is not None
        return open_constant(relations[j])

    zero = np.zeros(len(parameters.names))
    if jax.eval_shape(constant, zero) is None:
        return False
    return not np.any(np.asarray(jax.jit(jax.jacfwd(constant))(zero)))


def _scaled(
    parameters: Parameters,
    form: Form,
    signals: Signals,
    x: Float[np.ndarray, "N n"],
    constants: Float[np.ndarray, " c"],
    scale: Mapping[str, float],
) -> Parameters:
    """Sizes for parameters that start at zero: those that are given, the rms of the output
    for its offset, or else what makes the derivatives of the states as large again."""
    size = parameters.scale.copy()
    unit = dataclasses.replace(parameters, scale=np.ones_like(size))
    known = sizes_of(signals)
    for j in np.flatnonzero(size == 0):
        size[j] = known.get(parameters.names[j].partition("[")[0], 0.0)
    if (size == 0).any():

        def drift(q, x, u, y):
            return form.prediction(unit.place(q).model, constants).drift(x, u, y)

        zero = jnp.zeros(size.size)
        each = jax.vmap(drift, (None, 0, 0, 0))(zero, x, signals.u, signals.y)
        slopes = jax.vmap(jax.jacfwd(drift), (None, 0, 0, 0))(zero, x, signals.u, signals.y)
        each, slopes = np.asarray(each), np.asarray(slopes)
        for j in np.flatnonzero(size == 0):
            entries = np.any(slopes[:, :, j] != 0, axis=0)
            moved = np.sqrt(np.mean(slopes[:, entries, j] ** 2)) if entries.any() else 0.0
            size[j] = np.sqrt(np.mean(each[:, entries] ** 2)) / moved if moved else 1.0
    for name, value in scale.items():
        size[parameters.names.index(name)] = value
    return dataclasses.replace(parameters, scale=size)
