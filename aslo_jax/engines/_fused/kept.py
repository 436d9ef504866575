"""Programs that are kept for the next call."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


def shape_of(x: np.ndarray, drop: int = 0) -> jax.ShapeDtypeStruct:
    """Of an array without its first axes."""
    return jax.ShapeDtypeStruct(x.shape[drop:], x.dtype)


def wide_numbers() -> bool:
    """Whether JAX is in double precision, which a program depends on."""
    return jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


class _Recipe(NamedTuple):
    key: tuple[Any, ...]
    make: Callable[[], Any]

    def __hash__(self):
        return hash(self.key)

    def __eq__(self, other):
        return self.key == other.key


@functools.lru_cache(maxsize=32)
def _cached(recipe: _Recipe) -> Any:
    return recipe.make()


def kept(key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
    """What is made, once for equal keys where these can be compared."""
    try:
        hash(key)
    except TypeError:
        return make()
    return _cached(_Recipe(key, make))
