"""Intervals from the profile of the likelihood: where a parameter enters nonlinearly, the
curvature at the estimate says little of how far it may be off.

Source: Venzon, Moolgavkar, "A method for computing profile-likelihood-based confidence
intervals", Applied Statistics 37, 1988; doi:10.2307/2347496.
"""

import dataclasses
from collections.abc import Callable, Sequence

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
    - `low`, `high`: the ends of its interval; infinite where none was found;
    - `parabolic`: whether these are about where the curvature has them;
    - `allowed`: the errors of the record that make the interval wider.
    """

    place: Float[np.ndarray, " n"]
    deviance: Float[np.ndarray, " n"]
    low: float
    high: float
    parabolic: bool
    allowed: tuple[str, ...] = ()


def profile(
    evaluate: Evaluate,
    best: Float[np.ndarray, " v"],
    j: int,
    variance: float,
    deviation: float,
    confidence: float,
    inflation: Callable[[Float[np.ndarray, " v"]], float],
    farthest: float,
    degrees: int,
    enough: float = np.inf,
) -> Profile:
    """The profile over unknown `j` about the `best` unknowns.

    - `evaluate`: residuals, prior among them, and slopes of a vector of unknowns;
    - `variance`: of the errors;
    - `deviation`: of the parameter, by curvature, were the errors white;
    - `confidence`: of the interval;
    - `inflation`: of the variance, as the errors are not white, at some unknowns;
    - `farthest`: the distance from `best` at which the search gives up;
    - `degrees`: of freedom of the deviance of the true value: one, where the ends for all
      parameters are as the curvature says. Where one's is not, first and second order in it
      say about as much, and the deviance has at most the distribution for two;
    - `enough`: where the interval is no parabola, the distance from which on it is too wide
      to matter: where it reaches there, no end is looked for.
    """
    from scipy.special import chdtri  # heavy to import

    walk, sides = _Walk(evaluate, best, j, variance), (-1.0, 1.0)
    one, two = (float(chdtri(n, 1.0 - confidence)) for n in (degrees, 2))
    inflated = inflation(best)
    limit, width = one * inflated, float(np.sqrt(one * inflated)) * deviation
    ends = [walk.near(side, width, limit, farthest) for side in sides]
    parabolic = bool(np.isfinite(ends).all())
    if not parabolic and width < farthest:
        paths = [walk.path(side, width, two * inflated, farthest, enough) for side in sides]
        within = [v for path in paths for _, d, v in path if d < two * inflated]
        limit = two * max([inflated, *(inflation(v) for v in within)])
        ends = [_crossing(float(best[j]), path, limit) for path in paths]
    seen = sorted(walk.seen.items())
    place, deviance = (np.array(x) for x in zip(*seen, strict=True))
    low, high = (
        side * np.inf if np.isnan(end) else end
        for side, end in zip(sides, ends, strict=True)
    )
    return Profile(place, deviance, float(low), float(high), parabolic)


def _crossing(middle: float, path: Sequence[tuple], limit: float) -> float:
    """The outermost place at which the deviance rises above the limit; NaN for none."""
    crossing, here, last = np.nan, middle, 0.0
    for there, deviance, _ in path:
        if last < limit <= deviance:
            share = (limit - last) / (deviance - last)
            crossing = here + share * (there - here)
        elif deviance < limit:
            crossing = np.nan
        here, last = there, deviance
    return crossing


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
            with np.errstate(over="ignore"):  # a place where a model runs away
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

    def near(self, side: float, width: float, limit: float, farthest: float) -> float:
        """The end of the interval where it is as the curvature says; NaN where not."""
        if not width < farthest:
            return np.nan
        middle = float(self.best[self.j])
        deviance, _ = self._at(middle + side * width, self.best)
        if not abs(deviance / limit - 1.0) < LIKE_CURVATURE:
            return np.nan
        return middle + side * width * float(np.sqrt(limit / deviance))

    def path(
        self, side: float, width: float, limit: float, farthest: float, enough: float
    ) -> list[tuple]:
        """Places, deviances and unknowns, step by step outwards: a hill may hide another
        valley, so that one walks on for a while above the limit."""
        middle, v, found = float(self.best[self.j]), self.best, []
        for step in range(1, 10 * STEPS + 1):
            there = middle + side * width * step / STEPS
            if abs(there - middle) > farthest:
                break
            deviance, v = self._at(there, v)
            found.append((there, deviance, v))
            if abs(there - middle) > enough and deviance < limit:
                break
            high = 4.0 if step < 3 * STEPS else 1.0
            if deviance > high * limit and step >= STEPS:
                break
        return found
