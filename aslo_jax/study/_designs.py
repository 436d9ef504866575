"""Designs: points of the unit cube, by the index of a sample.

A design is called with a range of indices, in any order and cut in any way; the same index
is always the same point.
"""

import hashlib
import threading
from collections.abc import Callable, Sequence
from typing import get_args

import numpy as np
from jaxtyping import Float

from .. import _choices
from .._typing import DesignName

Design = Callable[[int, int], Float[np.ndarray, "N d"]]

DESIGNS = get_args(_choices.DesignName)
ALIGNED = 4  # a range starts at a multiple of this: Philox gives words in fours


def make_design(kind: DesignName, names: Sequence[str], seed: int, samples: int) -> Design:
    """`design(start, stop)`: the points of the samples from `start` to before `stop`, one
    coordinate, in (0, 1), for each of `names`.

    - `"iid"`: independent uniform numbers, counted by the sample and keyed by seed and
      name: a further name, or more samples, change none of them;
    - `"sobol"`: Sobol's points, scrambled (Owen 1998); a power of two of samples is best;
    - `"lhs"`: a Latin hypercube of exactly `samples` points. It is held in memory as a
      whole, 8 bytes for each number.
    """
    if kind not in DESIGNS:
        allowed = " or ".join(f'"{name}"' for name in DESIGNS)
        raise ValueError(f"Argument `design` must be {allowed}, but got {kind!r}.")
    if not names:
        return lambda start, stop: np.empty((stop - start, 0))
    if kind == "iid":
        return lambda start, stop: _independent(names, seed, start, stop)
    return _Sobol(names, seed) if kind == "sobol" else _LatinHypercube(names, seed, samples)


def _independent(names, seed, start, stop):
    columns = [_uniform(_words(name), seed, start, stop) for name in names]
    return np.stack(columns, axis=1)


def _words(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")


def _uniform(word: int, seed: int, start: int, stop: int) -> Float[np.ndarray, " N"]:
    # Salmon et al. 2011, doi:10.1145/2063384.2063405.
    if start % ALIGNED:
        raise ValueError(f"A range must start at a multiple of {ALIGNED}, but got {start}.")
    generator = np.random.Philox(key=[seed, word], counter=start // ALIGNED)
    raw = generator.random_raw(stop - start)
    # 53 bits, centred in their bin, so that neither 0 nor 1 occurs.
    return ((raw >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53


def _generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


class _Sobol:
    """Goes on from where it was where that is possible, and else starts again."""

    def __init__(self, names: Sequence[str], seed: int) -> None:
        self.names, self.dimension, self.seed = tuple(names), len(names), seed
        self.engine, self.position = self._start(), 0
        self.lock = threading.Lock()

    def __reduce__(self):
        # A lock cannot be sent to other processes, nor need be what it protects.
        return _Sobol, (self.names, self.seed)

    def _start(self):
        from scipy.stats import qmc

        return qmc.Sobol(self.dimension, scramble=True, rng=_generator(self.seed))

    def __call__(self, start, stop):
        with self.lock:
            return self._points(start, stop)

    def _points(self, start, stop):
        if start < self.position:
            self.engine, self.position = self._start(), 0
        if start > self.position:
            self.engine.fast_forward(start - self.position)
        # `random` warns of a number that is no power of two where it starts at zero; a
        # chunk is a part of the sequence only.
        points = np.empty((stop - start, self.dimension))
        first = 0
        if start == 0:
            points[:1], first = self.engine.random(1), 1
        if stop - start > first:
            points[first:] = self.engine.random(stop - start - first)
        self.position = stop
        # Points lie on a grid of 2^-30, the lowest at zero, where quantiles are infinite.
        return np.clip(points, 2.0**-32, 1.0 - 2.0**-32)


class _LatinHypercube:
    def __init__(self, names: Sequence[str], seed: int, samples: int) -> None:
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(len(names), rng=_generator(seed))
        points = sampler.random(samples)
        self.points = np.clip(points, 2.0**-53, 1.0 - 2.0**-53)

        self.arguments = tuple(names), seed, samples

    def __reduce__(self):
        # Drawn again in another process: it is sent with every chunk.
        return _LatinHypercube, self.arguments

    def __call__(self, start, stop):
        return self.points[start:stop]
