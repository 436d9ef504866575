"""How the observers of studies are made of a plant, by what is known of it.

Each function returns builders by kind of observer, as in [`Study`][]; a kind of machine
joins those that suit it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp

from .._completions import AbstractCompletion, LeastSquares, Repeat
from .._filters import LowPass
from .._guard import Guard
from ..derivation import derive
from ..observers import (
    FO1,
    FO2,
    FO3,
    AbstractObserver,
    AlgebraicObserver,
    Asymptotic,
    ExtendedKalman,
    FilteredDerivative,
    HighGain,
    Joined,
    Lifted,
    Luenberger,
    OpenLoopIntegrator,
    SuperTwisting,
    Unwrapped,
    velocity_observer,
)
from ..plants import AbstractMechanicalSystem
from . import _lifted
from ._rates import low_pass
from ._study import Build

Relations = Callable[[Any], Sequence[Any]]  # of a plant


def algebraic(relations: Relations, *, threshold: float = 1e-3) -> dict[str, Build]:
    """ASLO and A-ASLO of the plant's relations, the certificate below which they coast by
    default `threshold`."""

    def build(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "velocity_cutoff")

        def one(relation: Any) -> AbstractObserver:
            inner = algebraic_observer(relation, keys, threshold)
            return inner if gain is None else Asymptotic(inner, gain)

        gain = getattr(keys, "gain", None)
        return _joined(one, relations(plant))

    return {"aslo": build, "a-aslo": build}


def algebraic_observer(relation: Any, keys: Any, threshold: float) -> AlgebraicObserver:
    """The ASLO of a relation, with the keys of a table and a default `threshold`."""
    filter = low_pass(keys.cutoff, relation)
    completion = _completion(keys, relation)
    return AlgebraicObserver(
        relation, filter, completion, _guard(keys, threshold), keys.start
    )


def refuse_keys(keys: Any, *names: str) -> None:
    """Refuse a key of an observer that is given and would have no effect.

    **Raises:** `ValueError`.
    """
    for name in names:
        if getattr(keys, name) != type(keys).model_fields[name].default:
            raise ValueError(
                f"`{name}` has no effect on this observer of this machine; remove it"
            )


def one_number(keys: Any, *names: str) -> None:
    """Refuse several numbers where an observer takes one.

    **Raises:** `ValueError`.
    """
    for name in names:
        if isinstance(value := getattr(keys, name), list):
            raise ValueError(
                f"`{name}` must be one number for this machine, but is {value}"
            )


def _guard(keys: Any, threshold: float) -> Guard:
    return Guard(threshold if keys.threshold is None else keys.threshold)


def _completion(keys: Any, relation: Any) -> AbstractCompletion:
    if keys.completion == "repeat":
        refuse_keys(keys, "forgetting")
        return Repeat()
    if keys.forgetting is None:
        return LeastSquares()
    return LeastSquares(low_pass(keys.forgetting, relation))


def _joined(one: Callable[[Any], AbstractObserver], relations: Sequence[Any]) -> Any:
    """An observer of each relation; side by side where there are several."""
    every = tuple(map(one, relations))
    return every[0] if len(every) == 1 else Joined(every)


def integrator(relations: Relations) -> dict[str, Build]:
    """The integral of the known derivatives."""
    return {
        "open_loop": lambda keys, plant, start: _joined(
            OpenLoopIntegrator, relations(plant)
        )
    }


def lifted(relations: Relations) -> dict[str, Build]:
    """The Kalman filter of the plant's relations."""

    def build(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "force_deviation")
        deviations = keys.output_deviation, keys.input_deviation
        guard = Guard(keys.threshold)
        return _joined(
            lambda r: Lifted(r, *deviations, prior=keys.prior, guard=guard),
            relations(plant),
        )

    return {"lifted_kalman": build}


def adaptive(relations: Relations) -> dict[str, Build]:
    """The Kalman filter of the plant's relation with unknown parameters."""

    def build(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "force_deviation")
        (relation,) = relations(plant)
        return _lifted.adaptive(relation, keys)

    return {"adaptive": build}


def mixing(relations: Relations) -> dict[str, Build]:
    """FO3 of quadratic relations."""

    def build(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        filter = LowPass(keys.cutoff)
        return _joined(lambda r: FO3(r, filter, keys.gain), relations(plant))

    return {"fo3": build}


def of_round_motor() -> dict[str, Build]:
    """Those that know the magnet flux of a motor without saliency: FO1, FO2, and the
    extended Kalman filter."""

    def fo1(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        return FO1(plant.flux_relation(), LowPass(keys.cutoff), keys.gain)

    def fo2(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        return FO2(plant.flux_relation(), keys.gain, keys.one_sided)

    def kalman(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "drift")
        one_number(keys, "measurement")
        process = jnp.asarray(keys.process, float)
        relation = plant.flux_relation()
        return ExtendedKalman.of_pmsm(relation, keys.voltage, process, keys.measurement)

    return {"fo1": fo1, "fo2": fo2, "kalman": kalman}


def of_mechanism(*, threshold: float) -> dict[str, Build]:
    """Those of the velocities of a mechanical system, the certificate below which the
    algebraic ones coast by default `threshold`."""

    def algebraic(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "forgetting", "velocity_cutoff")
        return velocity_observer(
            plant,
            low_pass(keys.cutoff, None),
            gain=getattr(keys, "gain", None),
            completion=Repeat() if keys.completion == "repeat" else LeastSquares(),
            guard=_guard(keys, threshold),
            start=keys.start,
        )

    def kalman(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        refuse_keys(keys, "voltage", "drift")
        one_number(keys, "measurement")
        process = jnp.asarray(keys.process, float)
        return ExtendedKalman.of_mechanical(
            plant, process, keys.measurement, 1.0, initial=start.position
        )

    def lifted(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        return _lifted.lifted_velocities(plant, keys)

    def adaptive(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        refuse_keys(keys, "hold", "bank")
        return _lifted.lifted_velocities(plant, keys)

    def high_gain(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del start
        gain = jnp.asarray(keys.bandwidth, float)
        return HighGain(gain, plant if keys.model else None)

    def super_twisting(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del plant, start
        return SuperTwisting(jnp.asarray(keys.bound, float))

    def derivative(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del plant, start
        return FilteredDerivative(LowPass(keys.cutoff))

    return {
        "aslo": algebraic,
        "a-aslo": algebraic,
        "kalman": _unwrapping(kalman),
        "lifted_kalman": lifted,
        "adaptive": adaptive,
        "high_gain": _unwrapping(high_gain),
        "super_twisting": _unwrapping(super_twisting),
        "filtered_derivative": _unwrapping(derivative),
    }


def _unwrapping(build: Build) -> Build:
    """With angles unwrapped on the way in, where the system has any."""

    def unwrapped(keys: Any, plant: AbstractMechanicalSystem, start: Any):
        observer = build(keys, plant, start)
        return Unwrapped(observer, plant.angles) if any(plant.angles) else observer

    return unwrapped


MODEL = 1e-6  # the threshold of a derived relation, whose x may have many entries


def _derived(keys: Any, plant: Any, initial: Any) -> AbstractObserver:
    """ASLO or A-ASLO of the states of a plant that is a model."""
    refuse_keys(keys, "velocity_cutoff")
    found = derive(plant)
    _refuse_slow(keys, found.slowest)
    return found.observer(
        low_pass(keys.cutoff, None),
        completion=_completion(keys, None),
        guard=_guard(keys, MODEL),
        start=keys.start,
        gain=getattr(keys, "gain", None),
        initial=initial,
    )


def _refuse_slow(keys: Any, slowest: float) -> None:
    """Refuse filters that the fastest mode of a model outruns, whose rows only grow.

    **Raises:** `ValueError`.
    """
    own = keys.completion == "repeat" or keys.forgetting is not None
    limits = ("cutoff", 0.5 * slowest if own else slowest), ("forgetting", slowest)
    for name, limit in limits:
        value = getattr(keys, name)
        if isinstance(value, float) and value <= limit:
            raise ValueError(
                f"`{name}` must be above {limit:.4g} rad/s, by the fastest mode of the "
                f"model, but is {value:.4g}"
            )


def _relation_kalman(keys: Any, plant: Any, initial: Any) -> AbstractObserver:
    """The Kalman filter of the relation of a plant that is a model."""
    whole = lambda x, count: jnp.broadcast_to(jnp.asarray(x, float), (count,))
    return derive(plant).kalman_filter(
        whole(keys.output_deviation, len(plant.outputs)),
        whole(keys.input_deviation, len(plant.inputs)),
        prior=keys.prior,
        threshold=keys.threshold,
        initial=initial,
    )


def of_model() -> dict[str, Build]:
    """Those of a plant that is a model: what is derived from it, and copies of it. All
    begin with its parameters and first state."""

    def derived(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        return _derived(keys, plant, plant.hidden(start))

    def lifted(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        return _relation_kalman(keys, plant, plant.hidden(start))

    def kalman(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        refuse_keys(keys, "voltage")
        one_number(keys, "process")
        drift = keys.process if keys.drift is None else keys.drift
        measurement = jnp.asarray(keys.measurement, float)
        return ExtendedKalman.of_plant(plant, keys.process, drift, measurement, start)

    def luenberger(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        return Luenberger.of_plant(plant, keys.gain, start)

    return {
        "aslo": derived,
        "a-aslo": derived,
        "lifted_kalman": lifted,
        "kalman": kalman,
        "luenberger": luenberger,
    }


def of_modelled_machine() -> dict[str, Build]:
    """Those of an electrical machine that is a model."""

    def derived(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        return _derived(keys, plant, plant.hidden(start))

    def lifted(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        return _relation_kalman(keys, plant, plant.hidden(start))

    def kalman(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        refuse_keys(keys, "drift")
        one_number(keys, "process", "measurement")
        return ExtendedKalman.of_machine(
            plant, keys.voltage, keys.process, keys.measurement, flux=start.flux
        )

    return {
        "aslo": derived,
        "a-aslo": derived,
        "lifted_kalman": lifted,
        "kalman": kalman,
    }
