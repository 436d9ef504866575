"""Whether the disturbances of a study suit the signals that pass through them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ..._continuous import AnyExperiment, ContinuousExperiment
from ..._derive.plant import ModelPlant
from ...disturbances import AbstractDisturbance, Chain
from ...observers import AbstractObserver


def check_shapes(experiment: AnyExperiment) -> None:
    """Refuse a disturbance that changes the shape of its signal, or cannot take it, and an
    input that a model does not have.

    **Raises:** `ValueError` that names the key of a disturbance, `sensor.0` for instance.
    """
    y, u = jax.eval_shape(lambda: _signals(experiment))
    plant = experiment.plant
    if isinstance(plant, ModelPlant):
        jax.eval_shape(lambda u: plant.drift(plant.vector(plant.initial()), u), u)
    places: Mapping[str, Any] = {"sensor": y, "input_sensor": u, "actuator": u}
    for place, signal in places.items():
        whole = getattr(experiment, place)
        parts = whole.parts if isinstance(whole, Chain) else [whole]
        for k, part in enumerate(parts):
            if part is not None:
                _check(f"{place}.{k}", part, signal, y)


def _signals(experiment: AnyExperiment) -> tuple[Any, Any]:
    """Output and input at the start, without disturbances."""
    plant, start = experiment.plant, experiment.initial
    x = jax.tree.map(jnp.asarray, plant.initial() if start is None else start)
    y = plant.output(x)
    fed = y if experiment.feedback is None else experiment.feedback(y, x, {})
    state = experiment.controller.init(fed)
    command = experiment.controller(jnp.zeros(()), state, fed)
    return y, jax.tree.map(jnp.asarray, command)


def in_continuous_time(experiment: ContinuousExperiment, name: str) -> AbstractObserver:
    """The observer `name` of an experiment as one of continuous time: where its noise is
    that of samples, of those of the experiment's interval.

    **Raises:** `ValueError` that names its key where it has no form in continuous time.
    """
    observer = experiment.observers[name]
    if getattr(observer, "interval", 0.0) is None:
        observer = dataclasses.replace(observer, interval=experiment.interval)
    alone = dataclasses.replace(experiment, observers={name: observer})

    def rate() -> Any:
        loop, x0 = alone.begun(1)
        t = jnp.zeros(())
        return loop.vector_field(t, loop.init(t, x0), None)

    try:
        jax.eval_shape(rate)
    except ValueError as error:
        raise ValueError(
            f'`observers.{name}.kind` does not suit `time = "continuous"`: '
            f"{str(error).rstrip('.')}."
        ) from error
    return observer


def _check(key: str, part: AbstractDisturbance, signal: Any, output: Any) -> None:
    def disturbed(signal: Any, output: Any) -> Any:
        t = jnp.zeros(())
        return part(t, part.init(t, signal, output), signal, output)

    shapes = lambda tree: [x.shape for x in jax.tree.leaves(tree)]
    try:
        found = shapes(jax.eval_shape(disturbed, signal, output))
    except (TypeError, ValueError, IndexError) as error:
        raise ValueError(_message(key, signal)) from error
    if found != shapes(signal):
        raise ValueError(_message(key, signal))


def _message(key: str, signal: Any) -> str:
    sizes = [x.size for x in jax.tree.leaves(signal)]
    many = "one number" if sizes == [1] else f"{' and '.join(map(str, sizes))} entries"
    alone = " (no list)" if all(not x.shape for x in jax.tree.leaves(signal)) else ""
    return (
        f"`{key}` must suit its signal, which has {many}: its keys must be single "
        f"numbers{alone or ', or lists of as many'}."
    )
