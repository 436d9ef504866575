"""Distributions of the parameters of a study, as maps from the unit cube."""

import abc
import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._typing import HostArray

__all__ = [
    "AbstractDistribution",
    "Correlated",
    "Discrete",
    "LogNormal",
    "Normal",
    "Uniform",
]


class AbstractDistribution(abc.ABC):
    """A distribution of one number, or of several that depend on each other.

    It is sampled by its quantiles, so that one design of the unit cube serves all kinds.
    """

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """How many numbers it draws."""

    @abc.abstractmethod
    def quantiles(self, u: Float[np.ndarray, "N d"]) -> Float[np.ndarray, "N d"]:
        """The numbers at probabilities `u`, all in (0, 1)."""


@dataclasses.dataclass(frozen=True)
class Normal(AbstractDistribution):
    """The normal distribution of a `mean` and a standard `deviation`, of which only what is
    between `low` and `high` is drawn: truncated, where they are finite.

    **Raises:** `ValueError` for a `deviation` that is not positive, for limits that cross
    or lie far off the mean."""

    mean: float
    deviation: float
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        _finite("mean", self.mean)
        _positive("deviation", self.deviation)
        if not self.low < self.high:
            raise ValueError(
                "Argument `high` must be above `low`, but got "
                f"low = {self.low}, high = {self.high}."
            )
        if max(self.low - self.mean, self.mean - self.high) > 5.0 * self.deviation:
            raise ValueError(
                "Arguments `low` and `high` must leave what a normal distribution has "
                f"within five deviations of its mean, {self.mean}, but got "
                f"low = {self.low}, high = {self.high}."
            )

    @property
    def dimension(self) -> int:
        return 1

    def quantiles(self, u: HostArray) -> HostArray:
        if not (math.isfinite(self.low) or math.isfinite(self.high)):
            return _scipy().norm.ppf(u, self.mean, self.deviation)
        low, high = ((x - self.mean) / self.deviation for x in (self.low, self.high))
        found = _scipy().truncnorm.ppf(u, low, high, self.mean, self.deviation)
        return np.clip(found, self.low, self.high)


@dataclasses.dataclass(frozen=True)
class Uniform(AbstractDistribution):
    """The uniform distribution between `low` and `high`.

    **Raises:** `ValueError` where `high` is not above `low`.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _finite("low", self.low)
        _finite("high", self.high)
        if not self.low < self.high:
            raise ValueError(
                "Argument `high` must be above `low`, but got "
                f"low = {self.low}, high = {self.high}."
            )

    @property
    def dimension(self) -> int:
        return 1

    def quantiles(self, u: HostArray) -> HostArray:
        return _scipy().uniform.ppf(u, self.low, self.high - self.low)


@dataclasses.dataclass(frozen=True)
class LogNormal(AbstractDistribution):
    """A positive number whose logarithm is normal: `median` times `exp(s n)`, n standard
    normal and s the `deviation` of the logarithm (0.1 is about 10 %)."""

    median: float
    deviation: float

    def __post_init__(self) -> None:
        _positive("median", self.median)
        _positive("deviation", self.deviation)

    @property
    def dimension(self) -> int:
        return 1

    def quantiles(self, u: HostArray) -> HostArray:
        return _scipy().lognorm.ppf(u, self.deviation, scale=self.median)


@dataclasses.dataclass(frozen=True)
class Discrete(AbstractDistribution):
    """One of `values`, with `weights` in proportion to their probabilities, by default
    equal ones.

    **Raises:** `ValueError` without `values`, and for `weights` that do not fit them.
    """

    values: tuple[float, ...]
    weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        if not self.values:
            raise ValueError(
                "Argument `values` must hold at least one value, but is empty."
            )
        for value in self.values:
            _finite("values", value)
        if self.weights is None:
            return
        weights = tuple(float(w) for w in self.weights)
        object.__setattr__(self, "weights", weights)
        good = len(weights) == len(self.values) and np.isfinite(weights).all()
        if not (good and min(weights) >= 0.0 and sum(weights) > 0.0):
            raise ValueError(
                f"Argument `weights` must hold a weight for each of the "
                f"{len(self.values)} values, none negative and not all zero, but got "
                f"{list(weights)}."
            )

    @property
    def dimension(self) -> int:
        return 1

    def quantiles(self, u: HostArray) -> HostArray:
        values = np.asarray(self.values)
        weights = np.ones(values.size) if self.weights is None else np.array(self.weights)
        positions = np.arange(values.size)
        law = _scipy().rv_discrete(values=(positions, weights / weights.sum()))
        return values[law.ppf(u).astype(int)]


@dataclasses.dataclass(frozen=True)
class Correlated(AbstractDistribution):
    """Several numbers with a joint normal distribution.

    - `mean`, shape `(d,)`, and `covariance`, shape `(d, d)`, positive definite.

    **Raises:** `ValueError` for a `mean` or `covariance` that is not so, and for a
    correlation that does not fit.
    """

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        mean = np.asarray(self.mean, float)
        covariance = np.asarray(self.covariance, float)
        object.__setattr__(self, "mean", tuple(mean.tolist()))
        object.__setattr__(self, "covariance", tuple(map(tuple, covariance.tolist())))
        if mean.ndim != 1 or mean.size < 1 or not np.isfinite(mean).all():
            raise ValueError(
                f"Argument `mean` must be a list of finite numbers, but got {self.mean}."
            )
        good = covariance.shape == (mean.size, mean.size)
        good = good and np.isfinite(covariance).all()
        good = good and np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0)
        if not (good and np.linalg.eigvalsh(covariance).min() > 0.0):
            raise ValueError(
                f"Argument `covariance` must be a symmetric positive definite matrix of "
                f"{mean.size} rows, but got {covariance.tolist()}."
            )

    @classmethod
    def of(
        cls,
        mean: Sequence[float],
        deviation: Sequence[float],
        correlation: Sequence[Sequence[float]],
    ) -> "Correlated":
        """From standard deviations and a matrix of correlations, its diagonal 1."""
        matrix, size = np.asarray(correlation, float), np.asarray(deviation, float)
        if matrix.ndim != 2 or not np.allclose(np.diag(matrix), 1.0):
            raise ValueError(
                "Argument `correlation` must be a matrix with ones on its diagonal, but "
                f"got {matrix.tolist()}."
            )
        if matrix.shape != (size.size, size.size):
            raise ValueError(
                f"Argument `correlation` must have {size.size} rows and columns, one for "
                f"each deviation, but has the shape {matrix.shape}."
            )
        covariance = matrix * np.outer(size, size)
        return cls(tuple(mean), tuple(map(tuple, covariance.tolist())))

    @property
    def dimension(self) -> int:
        return len(self.mean)

    def quantiles(self, u: HostArray) -> HostArray:
        root = np.linalg.cholesky(np.asarray(self.covariance))
        standard = _scipy().norm.ppf(u)
        # Column by column: a product of matrices may round differently by its size, and a
        # sample must not depend on those that are drawn with it.
        found = np.tile(np.asarray(self.mean), (len(u), 1))
        for i in range(self.dimension):
            for j in range(i + 1):
                found[:, i] += root[i, j] * standard[:, j]
        return found


def _scipy():
    # Heavy to import, and not needed until something is drawn.
    import scipy.stats

    return scipy.stats


def _finite(name: str, x: float) -> None:
    if not np.isfinite(x):
        raise ValueError(f"Argument `{name}` must be finite, but got {x}.")


def _positive(name: str, x: float) -> None:
    if not (np.isfinite(x) and x > 0.0):
        raise ValueError(f"Argument `{name}` must be positive and finite, but got {x}.")
