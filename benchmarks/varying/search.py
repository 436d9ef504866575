"""The search for gains: the same for every contender."""

import math
from collections.abc import Callable
from typing import Any

ROUNDS, TRIALS = 3, 16


def tuned(gains: dict[str, tuple[float, float]], score: Callable[[Any], Any]) -> Any:
    """The gains, shape `(1, g)`, for which `score(gains)`, shape `(trials,)`, is least:
    Sobol points of the box of their logarithms, then as many about the best one of a box
    a quarter as wide, and so on."""
    import numpy as np
    from scipy.stats import qmc

    low, high = np.log(np.array(list(gains.values()))).T
    best, least = 0.5 * (low + high), math.inf
    for k in range(ROUNDS):
        half = 0.5 * (high - low) * 0.25**k
        sobol = qmc.Sobol(len(low), scramble=False).random(TRIALS)
        trials = np.clip(best + half * (2.0 * sobol - 1.0), low, high)
        found = np.asarray(score(np.exp(trials)))
        found = np.where(np.isfinite(found), found, np.inf)
        if found.min() < least:
            best, least = trials[found.argmin()], float(found.min())
    return np.exp(best)[None]
