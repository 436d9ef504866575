"""Counter-based random numbers: keyed by sample, counted by time index and stream."""

from ._random import (
    Key as Key,
    KeyLike as KeyLike,
    as_key as as_key,
    fold as fold,
    key as key,
    normal as normal,
    seed_of as seed_of,
    threefry as threefry,
    uniform as uniform,
)

__all__ = [
    "Key",
    "KeyLike",
    "as_key",
    "fold",
    "key",
    "normal",
    "seed_of",
    "threefry",
    "uniform",
]
