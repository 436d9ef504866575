"""The Cramer-Rao bound of a study, the reference line of its report."""

import dataclasses
from collections.abc import Mapping
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
_DRAWN = 4096  # values, for the deviation of a parameter
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
    unknown: Mapping[str, Any] | None = None,
) -> Bound:
    """The bound, averaged over the first samples of a study, so many `trajectories`, of the
    error over `scale`, shape `(n,)`, where one is given.

    - `experiment`, `spread`, `steps`, `key`: as in [`run`][];
    - `unknown`: as in [`cramer_rao`][]; those of [`unknown_in`][], for instance.

    It is one for observers that know all other parameters of each sample and nothing of its
    start: a deviation of 10 in every entry of the state, in its SI unit.

    **Raises:** as [`cramer_rao`][].
    """
    sampler = Sampler(experiment, spread, random.seed_of(key), trajectories)
    samples = sampler(np.arange(trajectories), sampler.values(0, trajectories))

    def make(sample: Any) -> Experiment:
        return dataclasses.replace(sampler.make(sample), observers={})

    state = jax.eval_shape(lambda: experiment.init()[0].x)
    prior = jax.tree.map(lambda x: jnp.full(x.shape, _PRIOR), state)
    bound = cramer_rao(make, samples, steps, prior=prior, unknown=unknown)
    if scale is None:
        return bound
    return dataclasses.replace(bound, variance=bound.variance / scale**2)


def unknown_in(experiment: Experiment, spread: Spread) -> dict[str, np.ndarray]:
    """The parameters of the plant that a spread varies and the observers do not know, with
    the deviation of each relative to its mean, shaped like it: the `unknown` of
    [`bound_of`][].

    - `experiment`, `spread`: as in [`run`][].

    What one item of the spread sets in several places is not among them, since it is known
    where one of them is an observer's; nor is a parameter whose mean is zero.
    """
    sampler = Sampler(experiment, spread, 0, _DRAWN)
    values = sampler.values(0, _DRAWN)
    mean, deviation = values.mean(0), values.std(0)
    layout, found = sampler.make.layout, {}
    for k, places in enumerate(sampler.make.places):
        path = layout.paths[places[0].leaf]
        stem, _, name = path.partition(".")
        if stem != "plant" or len(places) != 1 or mean[k] == 0.0:
            continue
        (place,) = places
        each = found.setdefault(name, np.zeros(np.shape(layout.leaves[place.leaf])))
        each[place.entry] = deviation[k] / abs(mean[k])
    return found


def with_reference(dataset: Any, configuration: "Configuration", seed: int) -> Any:
    """The `xarray.Dataset` of a study with its bound, or as it is without one."""
    if not has_bound(configuration):
        return dataset
    parts = configuration.experiment, configuration.spread
    settings = {"key": random.key(seed), "scale": configuration.scale}
    bound = bound_of(*parts, configuration.steps, **settings)
    names, unknown = unknown_in(*parts), None
    if names:
        unknown = bound_of(*parts, configuration.steps, unknown=names, **settings)
    return with_bound(dataset, bound, _after(configuration), unknown)


def _after(configuration: "Configuration") -> dict[str, float]:
    """From when on each rms error counts (s)."""
    tables = configuration.content["metrics"]
    return {n: float(t["after"]) for n, t in tables.items() if t["kind"] == "rms"}
