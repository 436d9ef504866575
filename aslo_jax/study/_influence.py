"""Which of the parameters that are spread in a study decide the error of each observer."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from .. import random
from .._continuous import AnyExperiment
from .._typing import Engine
from ..engines import Runner
from ..metrics._base import MakeMetric, metric_of
from ._sensitivity import Index, sobol_indices
from ._spread import Sampler, Spread

# Errors are judged by their logarithm, in the range in which it is finite.
_LEAST, _MOST = 1e-12, 1e12


def influences(
    experiment: AnyExperiment,
    spread: Spread,
    metric: MakeMetric,
    steps: int,
    *,
    scale: Float[np.ndarray, " n"] | None = None,
    base: int = 128,
    key: random.KeyLike | None = None,
    engine: Engine = "auto",
    confidence: float = 0.95,
) -> Mapping[str, list[Index]]:
    """The Sobol indices of the logarithm of a metric, by observer, the largest total first.

    - `experiment`, `spread`, `steps`, `scale`, `engine`: as in [`run`][]; `metric`: one of
      its `metrics`; of several entries the Euclidean norm counts, each over `scale`, shape
      `(n,)`;
    - `base`, `confidence`: as in [`sobol_indices`][].

    All points see the noise of the first sample of the study with that `key`, by default
    `jax.random.key(0)`. A metric
    that is not finite counts as 1e12.

    **Raises:** `ValueError` as [`sobol_indices`][], and without a spread.
    """
    sampler = Sampler(experiment, spread, random.seed_of(key), 1)
    if not sampler.names:
        raise ValueError("Argument `spread` must name a parameter, but is empty.")
    metrics = {name: metric_of(metric, name) for name in experiment.observers}
    runner = Runner(sampler.make, sampler.like(), steps, metrics=metrics, engine=engine)
    found: dict[str, Any] = {}

    def errors(u: Float[np.ndarray, "N d"], observer: str) -> Float[np.ndarray, " N"]:
        if not found:  # the points are the same for every observer
            samples = sampler(np.zeros(len(u), int), sampler.quantiles(u))
            found.update(runner(samples).metrics)
        x = np.asarray(found[observer], float).reshape(len(u), -1)
        size = np.linalg.norm(x if scale is None else x / scale, axis=1)
        return np.log(np.clip(np.nan_to_num(size, nan=_MOST), _LEAST, _MOST))

    return {
        observer: sobol_indices(
            lambda u, observer=observer: errors(u, observer),
            sampler.names,
            base,
            key=key,
            confidence=confidence,
        )
        for observer in experiment.observers
    }
