"""Observers against each other on common random numbers: which is better, by how much, and
whether chance could have done it."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from ._statistics import Interval, judged, proportion, quantile


class Comparison(NamedTuple):
    """One observer, `first`, against another, `second`, sample by sample.

    - `ratio`: the median of the metric of the first over that of the second, with its
      interval from order statistics: the size of the effect, below 1 where the first is
      better;
    - `wins`: the proportion of the samples in which the first is better, with its interval;
      `ties` that in which neither is;
    - `p`: of Wilcoxon's signed-rank test, two-sided, corrected by Holm for all the pairs
      compared: how surely chance alone does less;
    - `better`: the one that the ranks favour, or `None` where `p` is not below one minus
      the confidence asked for.
    """

    first: str
    second: str
    ratio: Interval
    wins: Interval
    ties: float
    p: float
    better: str | None


class Place(NamedTuple):
    """A line of a ranking: `rank` is one more than the number of observers that are better
    beyond chance, so that two may share one; `median` of the metric over samples; `ratio`
    and `p` as in [`Comparison`][], against the observer of the first line."""

    rank: int
    observer: str
    median: Interval
    ratio: Interval
    p: float


def compare(
    values: Mapping[str, Float[np.ndarray, " N"]], confidence: float = 0.95
) -> list[Comparison]:
    """Every pair of observers on a metric that is not negative, the smaller the better;
    `values` by observer, sample by sample on the same random numbers, each of shape `(N,)`.

    - `confidence`: of the intervals, between 0 and 1, and of `better`, over all pairs.

    The test is on the logarithm of the ratio: errors spread over decades, and a test on
    differences would hear the largest ones only. It is on the difference for a pair with a
    zero in it, as times and fractions have, whose ratio to anything says too much. A sample
    that diverged (infinite or not a number) is worse than any that did not; where both did,
    or both are zero, it is a tie.

    Source: Wilcoxon 1945, doi:10.2307/3001968; ties by Pratt 1959,
    doi:10.1080/01621459.1959.10501526; Holm 1979, doi:10.2307/4615733.

    **Raises:** `ValueError` for `values` of different shapes, and for a `confidence` out of
    (0, 1).
    """
    sizes = {name: np.shape(x) for name, x in values.items()}
    if len(set(sizes.values())) > 1 or any(len(size) != 1 for size in sizes.values()):
        raise ValueError(
            "Argument `values` must hold as many samples for every observer, in one "
            f"dimension, but their shapes are {sizes}."
        )
    pairs = list(itertools.combinations(values, 2))
    checked = {name: _checked(name, x) for name, x in values.items()}
    tests = [_test(checked[a], checked[b], confidence) for a, b in pairs]
    corrected = holm(np.array([min(1.0, 2.0 * min(test[3:])) for test in tests]))
    found = []
    for (a, b), test, p in zip(pairs, tests, corrected, strict=True):
        ratio, wins, ties, less, greater = test
        favoured = a if less < greater else b
        better = favoured if p < 1.0 - confidence else None
        found.append(Comparison(a, b, ratio, wins, ties, float(p), better))
    return found


def ranking(
    values: Mapping[str, Float[np.ndarray, " N"]],
    confidence: float = 0.95,
    comparisons: Sequence[Comparison] | None = None,
) -> list[Place]:
    """The observers from the best to the worst on a metric, `values` by observer, each of
    shape `(N,)`, at a `confidence` between 0 and 1, from the `comparisons` that
    [`compare`][] makes of the same arguments where they are not given.
    """
    if comparisons is None:
        comparisons = compare(values, confidence)
    beaten = dict.fromkeys(values, 0)
    for comparison in comparisons:
        if comparison.better is not None:
            first = comparison.better == comparison.first
            beaten[comparison.second if first else comparison.first] += 1
    medians = {name: quantile(x, 0.5, confidence) for name, x in values.items()}
    order = sorted(values, key=lambda name: (beaten[name], medians[name].value))
    places = [Place(beaten[order[0]] + 1, order[0], medians[order[0]], _SAME, 1.0)]
    for name in order[1:]:
        pair = {name, order[0]}
        (found,) = (c for c in comparisons if {c.first, c.second} == pair)
        value, low, high = found.ratio
        ratio = found.ratio
        if found.second == name:
            ratio = Interval(_inverse(value), _inverse(high), _inverse(low))
        places.append(Place(beaten[name] + 1, name, medians[name], ratio, found.p))
    return places


def holm(p: Float[np.ndarray, " tests"]) -> Float[np.ndarray, " tests"]:
    """The values of `p`, corrected so that the chance of any false finding among the tests
    stays below the level."""
    order = np.argsort(p, kind="stable")
    steps = p[order] * np.arange(p.size, 0, -1)
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected


_SAME = Interval(1.0, 1.0, 1.0)


def _checked(name: str, x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    x = judged(x)
    if (x < 0).any():
        raise ValueError(
            "Argument `values` must not be negative (take the magnitude of a signed "
            f"error), but the least of {name!r} is {x.min():.6g}."
        )
    return x


def _test(
    a: Float[np.ndarray, " N"], b: Float[np.ndarray, " N"], confidence: float
) -> tuple[Interval, Interval, float, float, float]:
    """The ratio, wins, ties, and the chances of ranks so low and so high."""
    tie = a == b
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.where(tie, 0.0, np.log(a) - np.log(b))
        difference = np.where(tie, 0.0, a - b)
    ratio = Interval(*np.exp(quantile(logarithm, 0.5, confidence)).tolist())
    wins = proportion(int((a < b).sum()), a.size, confidence)
    ties = float(tie.mean())
    if ties == 1.0:
        return ratio, wins, ties, 1.0, 1.0
    d = logarithm if a.min() > 0.0 and b.min() > 0.0 else difference
    # Ranks only: any number beyond the finite ones stands for infinity.
    far = 2.0 * np.abs(d[np.isfinite(d)]).max(initial=0.5)
    d = np.clip(d, -far, far)
    return ratio, wins, ties, _signed_rank(d, "less"), _signed_rank(d, "greater")


def _signed_rank(d: Float[np.ndarray, " N"], side: str) -> float:
    found: Any = scipy.stats.wilcoxon(d, zero_method="pratt", alternative=side)
    return float(found.pvalue)


def _inverse(x: float) -> float:
    return np.inf if x == 0.0 else 1.0 / x
