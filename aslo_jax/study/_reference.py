"""The Cramer-Rao bound of a study, the reference line of its report."""

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import random
from .._experiment import Experiment
from ..disturbances import Chain, SampledNoise
from ._bound import Bound, cramer_rao, with_bound
from ._spread import Sampler, Spread

if TYPE_CHECKING:
    from ._config import Configuration

TRAJECTORIES = 64
# What is known of the start: as good as nothing, beside what a second of samples says.
_PRIOR = 10.0


def has_bound(configuration: "Configuration") -> bool:
    """Whether [`bound_of`][] supports a study: of a machine whose kind says so, with noise
    that is sampled, and an rms error among the metrics."""
    from ..machines import studies  # with pydantic, which `bound_of` does without

    sensor = configuration.experiment.sensor
    parts = sensor.parts if isinstance(sensor, Chain) else (sensor,)
    noisy = any(isinstance(part, SampledNoise) for part in parts)
    supported = studies()[configuration.content["machine"]["kind"]].bound
    return supported and noisy and bool(_after(configuration))


def bound_of(
    experiment: Experiment,
    spread: Spread,
    steps: int,
    *,
    key: random.KeyLike,
    trajectories: int = TRAJECTORIES,
    scale: Float[np.ndarray, " n"] | None = None,
) -> Bound:
    """The bound, averaged over the first samples of a study, so many `trajectories`, of the
    error over `scale`, shape `(n,)`, where one is given.

    - `experiment`, `spread`, `steps`, `key`: as in [`run`][].

    It is one for observers that know the parameters of each sample and nothing of its
    start: a deviation of 10 in every entry of the state, in its SI unit.

    **Raises:** as [`cramer_rao`][].
    """
    sampler = Sampler(experiment, spread, random.seed_of(key), trajectories)
    samples = sampler(np.arange(trajectories), sampler.values(0, trajectories))

    def make(sample: Any) -> Experiment:
        return dataclasses.replace(sampler.make(sample), observers={})

    state = jax.eval_shape(lambda: experiment.init()[0].x)
    prior = jax.tree.map(lambda x: jnp.full(x.shape, _PRIOR), state)
    bound = cramer_rao(make, samples, steps, prior=prior)
    return bound if scale is None else Bound(bound.t, bound.variance / scale**2)


def with_reference(dataset: Any, configuration: "Configuration", seed: int) -> Any:
    """The `xarray.Dataset` of a study with its bound, or as it is without one."""
    if not has_bound(configuration):
        return dataset
    bound = bound_of(
        configuration.experiment,
        configuration.spread,
        configuration.steps,
        key=random.key(seed),
        scale=configuration.scale,
    )
    return with_bound(dataset, bound, _after(configuration))


def _after(configuration: "Configuration") -> dict[str, float]:
    """From when on each rms error counts (s)."""
    tables = configuration.content["metrics"]
    return {n: float(t["after"]) for n, t in tables.items() if t["kind"] == "rms"}
