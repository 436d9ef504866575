"""One sample of a study once more, with everything that happens in it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import random
from .._checks import counted
from .._continuous import AnyExperiment
from .._experiment import Record
from .._simulate import Simulation
from .._typing import Engine
from ..engines import Runner
from ..metrics._base import MakeMetric
from ._distributions import AbstractDistribution
from ._problem import BLOCK, of_each
from ._run import steps_of, whole
from ._spread import Parameter, Sampler, Spread


class Rerun(NamedTuple):
    """A `sample` of a study, counted from 0.

    - `parameters`: the numbers drawn for it, by their names;
    - `metrics`: by name and observer;
    - `simulation`: every signal, as of [`simulate`][].
    """

    sample: int
    parameters: dict[str, float]
    metrics: dict[str, dict[str, np.ndarray]]
    simulation: Simulation[Any]


def rerun(
    experiment: AnyExperiment,
    spread: Spread | Mapping[str, Parameter | tuple[Any, AbstractDistribution]],
    *,
    samples: int,
    key: random.KeyLike,
    index: int,
    metrics: Mapping[str, MakeMetric],
    steps: int | None = None,
    horizon: float | None = None,
    every: int = 1,
    engine: Engine = "auto",
) -> Rerun:
    """Run the sample `index`, counted from 0, of a study again and keep every signal.

    - `experiment`, `spread`, `samples`, `key`, `metrics`, `steps`, `horizon` (s), `engine`:
      those of [`run`][] for that study;
    - `every`: keeps every `every`-th instant, the first included.

    With the engine `"fused"` the metrics have the bits that the study has on the same
    machine.

    **Raises:** `ValueError` for arguments that do not fit, and an `index` that the study
    does not have.
    """
    samples, index = whole("samples", samples), counted("index", index)
    if not 0 <= index < samples:
        raise ValueError(
            f"Argument `index` must be from 0 to {samples - 1}, for {samples} samples, but "
            f"got {index}."
        )
    spread = spread if isinstance(spread, Spread) else Spread(spread)
    sampler = Sampler(experiment, spread, random.seed_of(key), samples)
    first = index // BLOCK * BLOCK  # a design is drawn in blocks
    values = sampler.values(first, index + 1)[-1:]
    runner = Runner(
        sampler.make,
        sampler.like(),
        steps_of(experiment, steps, horizon),
        metrics=of_each(metrics, experiment.observers),
        record=_everything,
        every=every,
        engine=engine,
    )
    batch = runner(sampler(np.array([index]), values))
    found = {name: np.asarray(x)[0] for name, x in batch.metrics.items()}
    record = jax.tree.map(lambda x: jnp.asarray(x)[0], batch.record)
    return Rerun(
        index,
        dict(zip(sampler.names, map(float, values[0]), strict=True)),
        {
            name: {each: found[f"{name}/{each}"] for each in experiment.observers}
            for name in metrics
        },
        Simulation(**record, states={}),
    )


def _everything(record: Record[Any]) -> dict[str, Any]:
    return {
        name: getattr(record, name) for name in ("t", "u", "y", "x", "hidden", "estimates")
    }
