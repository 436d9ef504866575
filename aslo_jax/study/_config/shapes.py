"""Whether the disturbances of a study suit the signals that pass through them."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ..._derive.plant import ModelPlant
from ..._experiment import Experiment
from ...disturbances import AbstractDisturbance, Chain


def check_shapes(experiment: Experiment) -> None:
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


def _signals(experiment: Experiment) -> tuple[Any, Any]:
    """Output and input at the start, without disturbances."""
    plant, start = experiment.plant, experiment.initial
    x = jax.tree.map(jnp.asarray, plant.initial() if start is None else start)
    y = plant.output(x)
    fed = experiment._fed(y, x, {})
    state = experiment.controller.init(fed)
    command, _ = experiment._control(jnp.zeros_like(experiment.interval), state, fed)
    return y, command


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
