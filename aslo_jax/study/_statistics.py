"""Statistics of a metric over the samples of a study, each with a confidence interval.

A sample that diverged, whose metric is not a number or infinite, is the worst there is: it
counts as infinite in every quantile and in the worst, makes a mean infinite, and is counted
besides. None is left out.

The intervals are those of independent samples. For a Latin hypercube of N samples the
variance of a mean is at most N/(N - 1) times theirs (Owen 1997,
doi:10.1214/aos/1031594730), so that they are cautious.
"""

from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from .. import random

# More samples than this are resampled as so many batches of consecutive ones: the bootstrap
# then costs the same for any number of samples, and still corrects for skewness, since that
# of a mean is the same whether or not its terms are added in batches.
BATCHES = 200
RESAMPLES = 1_999


class Interval(NamedTuple):
    """A statistic: its `value`, and the `low` and `high` end of its confidence interval."""

    value: float
    low: float
    high: float

    def scaled(self, by: float) -> "Interval":
        """In other units: everything times a positive number."""
        return Interval(self.value * by, self.low * by, self.high * by)


class Summary(NamedTuple):
    """What a report says of one metric of one observer.

    - `samples`; `failures` of them, where the metric is not a finite number, and the
      `failing` proportion they estimate;
    - `low`, `median`, `high`: the quantiles 5, 50 and 95 %; `mean`, `rms` over samples;
    - `worst`, the largest value, and the first sample, counted from 0, that has it; with
      the confidence asked for, at least the proportion `below` of all possible samples lies
      at or below it.
    """

    samples: int
    failures: int
    failing: Interval
    low: Interval
    median: Interval
    high: Interval
    mean: Interval
    rms: Interval
    worst: float
    worst_sample: int
    below: float


def summarise(
    x: Float[np.ndarray, " N"], confidence: float = 0.95, key: random.KeyLike | None = None
) -> Summary:
    """All statistics of a metric `x`, shape `(N,)`, the smaller the better, one value per
    sample.

    - `confidence`: of the intervals, between 0 and 1;
    - `key`: of the bootstrap, by default that of seed 0.
    """
    x = judged(x)
    failures = int(np.isinf(x).sum())
    ordered = np.sort(x)
    low, median, high = (of_sorted(ordered, p, confidence) for p in (0.05, 0.5, 0.95))
    return Summary(
        samples=x.size,
        failures=failures,
        failing=proportion(failures, x.size, confidence),
        low=low,
        median=median,
        high=high,
        mean=mean(x, confidence, key),
        rms=rms(x, confidence, key),
        worst=float(ordered[-1]),
        worst_sample=int(np.argmax(x)),
        below=(1.0 - confidence) ** (1.0 / x.size),
    )


def judged(x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Copies `x`, of at least one value, with infinity for what is not a number."""
    x = np.array(x, float)
    if x.size == 0:
        raise ValueError("Argument `x` must hold at least one sample, but it is empty.")
    x[np.isnan(x)] = np.inf
    return x


def quantile(
    x: Float[np.ndarray, " N"], probability: float, confidence: float = 0.95
) -> Interval:
    """The quantile of `x`, shape `(N,)`, at a `probability` between 0 and 1, and its
    interval with a `confidence` between 0 and 1, from order statistics.
    """
    return of_sorted(np.sort(judged(x)), probability, confidence)


def of_sorted(
    ordered: Float[np.ndarray, " N"], probability: float, confidence: float = 0.95
) -> Interval:
    """A quantile of samples in ascending order, and an interval between two of them that
    holds for any distribution: the number of samples below the quantile is binomial.

    An end is infinite where there are too few samples for one.

    Source: David, Nagaraja, "Order Statistics", 3rd ed. 2003, section 7.1.
    """
    _check_confidence(confidence)
    if not 0.0 < probability < 1.0:
        raise ValueError(
            f"Argument `probability` must be between 0 and 1, but got {probability}."
        )
    n = ordered.size
    # The sample quantile: where two order statistics share it, their mean (2 of
    # Hyndman and Fan), but never a value between a finite one and infinity.
    at = n * probability
    below, above = ordered[int(np.ceil(at)) - 1], ordered[min(int(np.floor(at)), n - 1)]
    value = below if np.isinf(above) else (below + above) / 2.0
    tail = 0.5 * (1.0 - confidence)
    first = int(scipy.stats.binom.ppf(tail, n, probability)) - 1
    last = int(scipy.stats.binom.ppf(1.0 - tail, n, probability))
    low = ordered[first] if first >= 0 else -np.inf
    high = ordered[last] if last < n else np.inf
    return Interval(float(value), float(low), float(high))


def mean(
    x: Float[np.ndarray, " N"], confidence: float = 0.95, key: random.KeyLike | None = None
) -> Interval:
    """The mean of `x`, and its interval by the bootstrap, bias-corrected and accelerated,
    from random numbers that depend on `key` only, by default that of seed 0. Infinite
    where a sample diverged.

    Source: Efron, J. Am. Stat. Assoc. 82 (1987) 171, doi:10.1080/01621459.1987.10478410.
    """
    _check_confidence(confidence)
    x = judged(x)
    value = float(np.mean(x))
    if not np.isfinite(value):
        return Interval(value, value, value)
    if x.size == 1:
        return Interval(value, -np.inf, np.inf)
    sums, counts = _batches(x)
    means = sums / counts
    # Rounding of the sums apart: with nothing to resample, the bootstrap is undefined.
    if np.ptp(means) <= 1e-14 * np.abs(means).max():
        return Interval(value, value, value)
    found = scipy.stats.bootstrap(
        (sums, counts),
        lambda s, c, axis: np.sum(s, axis) / np.sum(c, axis),
        paired=True,
        vectorized=True,
        confidence_level=confidence,
        n_resamples=RESAMPLES,
        batch=200,
        method="BCa",
        rng=np.random.default_rng(random.seed_of(key)),
    ).confidence_interval
    return Interval(value, float(found.low), float(found.high))


def rms(
    x: Float[np.ndarray, " N"], confidence: float = 0.95, key: random.KeyLike | None = None
) -> Interval:
    """The root of the mean square of `x`, from the [`mean`][] of its squares: the bootstrap
    keeps its coverage under a monotone function."""
    x = judged(x)
    # Relative to the largest, so that a large metric does not overflow.
    scale = float(np.abs(x).max())
    if not np.isfinite(scale) or scale == 0.0:
        return Interval(scale, scale, scale)
    square = mean((x / scale) ** 2, confidence, key)
    root = (scale * float(np.sqrt(max(part, 0.0))) for part in square)
    return Interval(*root)


def proportion(count: int, samples: int, confidence: float = 0.95) -> Interval:
    """`count` out of `samples`, and the exact interval of Clopper and Pearson."""
    _check_confidence(confidence)
    found = scipy.stats.binomtest(count, samples).proportion_ci(confidence)
    return Interval(count / samples, float(found.low), float(found.high))


def _batches(
    x: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, " B"], Float[np.ndarray, " B"]]:
    """The sum and the number of the samples in each batch of consecutive ones."""
    edges = np.linspace(0, x.size, min(x.size, BATCHES) + 1).astype(int)
    return np.add.reduceat(x, edges[:-1]), np.diff(edges).astype(float)


def _check_confidence(confidence: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ValueError(
            f"Argument `confidence` must be between 0 and 1, but got {confidence}."
        )
