"""The Cramer-Rao bound of a study, the reference line of its report."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import random
from .._continuous import AnyExperiment
from .._experiment import Experiment
from .._typing import PyTree
from ..disturbances import Chain, SampledNoise
from ._bound import Bound, both_bounds, cramer_rao, with_bound
from ._leaves import started
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

    if not isinstance(configuration.experiment, Experiment):
        return False  # it is one of samples
    sensor = configuration.experiment.sensor
    parts = sensor.parts if isinstance(sensor, Chain) else (sensor,)
    noisy = any(isinstance(part, SampledNoise) for part in parts)
    supported = studies()[configuration.content["machine"]["kind"]].bound
    return supported and noisy and bool(_after(configuration))


def bound_of(
    experiment: AnyExperiment,
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
    make, samples, prior = _trajectories(experiment, spread, key, trajectories)
    bound = cramer_rao(make, samples, steps, prior=prior, unknown=unknown)
    return _over(bound, scale)


def _trajectories(
    experiment: AnyExperiment, spread: Spread, key: random.KeyLike, count: int
) -> tuple[Callable[[PyTree], Any], PyTree, PyTree]:
    """The experiments without observers, their first samples, and what is known of the
    start."""
    sampler = Sampler(experiment, spread, random.seed_of(key), count)
    samples = sampler(np.arange(count), sampler.values(0, count))

    def make(sample: Any) -> AnyExperiment:
        return dataclasses.replace(sampler.make(sample), observers={})

    state = jax.eval_shape(lambda: started(experiment).initial)
    return make, samples, jax.tree.map(lambda x: jnp.full(x.shape, _PRIOR), state)


def _over(bound: Bound, scale: Float[np.ndarray, " n"] | None) -> Bound:
    if scale is None:
        return bound
    return dataclasses.replace(bound, variance=bound.variance / scale**2)


def unknown_in(experiment: AnyExperiment, spread: Spread) -> dict[str, np.ndarray]:
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
    experiment, spread = configuration.experiment, configuration.spread
    assert isinstance(experiment, Experiment)
    names, unknown = unknown_in(experiment, spread), None
    make, samples, prior = _trajectories(experiment, spread, random.key(seed), TRAJECTORIES)
    parts, scale = (make, samples, configuration.steps), configuration.scale
    if names:
        bound, unknown = both_bounds(*parts, prior=prior, unknown=names)
        unknown = _over(unknown, scale)
    else:
        bound = cramer_rao(*parts, prior=prior)
    return with_bound(dataset, _over(bound, scale), _after(configuration), unknown)


def _after(configuration: "Configuration") -> dict[str, float]:
    """From when on each rms error counts (s)."""
    tables = configuration.content["metrics"]
    return {n: float(t["after"]) for n, t in tables.items() if t["kind"] == "rms"}
