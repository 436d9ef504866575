"""Bands of the estimation error over time, in one pass over the samples."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

# Errors are counted in bins that are 1 % wide, from `_LEAST` to a thousand million: a
# quantile is then right to 0.5 %, and the counts take the same memory for any number of
# samples, which a sort would not.
_WIDTH = np.log(1.01)
_LEAST = 1e-15
_BINS = int(np.ceil(np.log(1e9 / _LEAST) / _WIDTH))
_BLOCK = 2**22  # bytes of trajectories that are read at once


class Band(NamedTuple):
    """The error of one observer over samples at each instant: the quantiles 5, 50 and 95 %,
    right to 0.5 %, and the `worst` sample, all of shape `(T,)`; infinite where a sample
    diverged."""

    low: Float[np.ndarray, " T"]
    median: Float[np.ndarray, " T"]
    high: Float[np.ndarray, " T"]
    worst: Float[np.ndarray, " T"]


def bands(error: Any) -> Mapping[str, Band]:
    """The band of each observer from `error`, an `xarray.DataArray` over `sample`, `time`
    and `observer`: norms of the estimation error."""
    error = error.transpose("sample", "time", "observer")
    samples, *shape = error.shape
    series = int(np.prod(shape))
    # Bin 0 is for what is less than the least, the last for infinity.
    counts = np.zeros((series, _BINS + 2), np.int64)
    worst = np.zeros(series)
    for block in _blocks(error):
        x = np.asarray(block.values, float).reshape(-1, series)
        x[np.isnan(x)] = np.inf
        np.maximum(worst, x.max(0), out=worst)
        np.add.at(counts, (np.arange(series), _bin(x)), 1)
    cumulative = np.cumsum(counts, 1, out=counts)
    low, median, high = (
        _value((cumulative < p * samples).sum(1)).reshape(shape) for p in (0.05, 0.5, 0.95)
    )
    names = [str(name) for name in error.observer.values]
    parts = zip(low.T, median.T, high.T, worst.reshape(shape).T, strict=True)
    return {name: Band(*part) for name, part in zip(names, parts, strict=True)}


def _blocks(error: Any) -> Iterator[Any]:
    """Consecutive samples, whole chunks of the store where there is one."""
    samples = error.sizes["sample"]
    each = 8 * error.size // samples
    chunk = (error.encoding.get("chunks") or [1])[0]
    size = max(1, _BLOCK // (each * chunk)) * chunk
    for start in range(0, samples, size):
        yield error.isel(sample=slice(start, start + size))


def _bin(x: Float[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    with np.errstate(divide="ignore"):
        place = np.floor((np.log(x) - np.log(_LEAST)) / _WIDTH) + 1.0
    place = np.clip(place, 0.0, float(_BINS))
    return np.where(np.isinf(x), _BINS + 1, place).astype(np.int64)


def _value(place: Int[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The middle of a bin."""
    middle = _LEAST * np.exp((place - 0.5) * _WIDTH)
    return np.where(place == 0, 0.0, np.where(place > _BINS, np.inf, middle))
