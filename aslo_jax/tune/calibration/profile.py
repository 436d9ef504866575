"""Intervals from the profile of the likelihood: where a parameter enters nonlinearly, the
curvature at the estimate says little of how far it may be off.

Source: Venzon, Moolgavkar, "A method for computing profile-likelihood-based confidence
intervals", Applied Statistics 37, 1988; doi:10.2307/2347496.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

LIKE_CURVATURE = 0.15  # the share by which an end may differ from that of the curvature
STEPS = 8  # of a walk to one side, in widths of the interval by curvature
NEWTON = 4  # steps of the others at every place

Evaluate = Callable[
    [Float[np.ndarray, " v"]], tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r v"]]
]


@dataclasses.dataclass(frozen=True)
class Profile:
    """The least sum of squares over a parameter, all others free.

    - `place`: of the parameter, relative to where it started, shape `(n,)`, in order;
    - `deviance`: the sum of squares above the least one, in variances of the errors;
    - `low`, `high`: the ends of its interval; infinite where none was found.
    """

    place: Float[np.ndarray, " n"]
    deviance: Float[np.ndarray, " n"]
    low: float
    high: float


def profile(
    evaluate: Evaluate,
    best: Float[np.ndarray, " v"],
    j: int,
    variance: float,
    deviation: float,
    factor: float,
    inflation: float,
    farthest: float,
) -> Profile:
    """The profile over unknown `j` about the `best` unknowns.

    - `evaluate`: residuals, prior among them, and slopes of a vector of unknowns;
    - `variance`: of the errors;
    - `deviation`: of the parameter, by curvature; `factor`: of it, to an end;
    - `inflation`: of the variance, as the errors are not white;
    - `farthest`: the distance from `best` at which the search gives up.
    """
    walk = _Walk(evaluate, best, j, variance)
    limit = factor**2 * inflation
    ends = [walk.end(side, factor * deviation, limit, farthest) for side in (-1.0, 1.0)]
    seen = sorted(walk.seen.items())
    place, deviance = (np.array(x) for x in zip(*seen, strict=True))
    return Profile(place, deviance, ends[0], ends[1])


class _Walk:
    def __init__(
        self, evaluate: Evaluate, best: Float[np.ndarray, " v"], j: int, variance: float
    ):
        self.evaluate, self.best, self.j, self.variance = evaluate, best, j, variance
        residuals, _ = evaluate(best)
        self.least = float(residuals @ residuals)
        self.seen = {float(best[j]): 0.0}

    def _at(self, place: float, start: Float[np.ndarray, " v"]):
        """The deviance with the parameter at `place`, the others searched from `start`."""
        v = start.copy()
        v[self.j] = place
        others = np.arange(v.size) != self.j
        least, kept = np.inf, v
        for _ in range(NEWTON):
            residuals, slopes = self.evaluate(v)
            found = float(residuals @ residuals)
            if not found < least - 0.02 * self.variance:
                if found < least:
                    least, kept = found, v
                break
            least, kept = found, v
            step, *_ = np.linalg.lstsq(slopes[:, others], residuals, rcond=1e-12)
            v = v.copy()
            v[others] -= step
        deviance = (least - self.least) / self.variance
        self.seen[place] = deviance
        return deviance, kept

    def end(self, side: float, width: float, limit: float, farthest: float) -> float:
        middle = float(self.best[self.j])
        if not width < farthest:
            return side * np.inf
        deviance, v = self._at(middle + side * width, self.best)
        if abs(deviance / limit - 1.0) < LIKE_CURVATURE:
            return middle + side * width * np.sqrt(limit / deviance)
        # Far from a parabola: every place counts, for a hill may hide another valley.
        last, v, crossing = 0.0, self.best, side * np.inf
        here = middle
        for step in range(1, 3 * STEPS + 1):
            there = middle + side * width * step / STEPS
            if abs(there - middle) > farthest:
                return side * np.inf if last < limit else crossing
            deviance, v = self._at(there, v)
            if last < limit <= deviance:
                share = (limit - last) / (deviance - last)
                crossing = here + share * (there - here)
            elif deviance < limit:
                crossing = side * np.inf
            if deviance > 4.0 * limit and step >= STEPS:
                break
            here, last = there, deviance
        return crossing
