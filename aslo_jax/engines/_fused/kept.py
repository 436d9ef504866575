"""Programs that are kept for the next call."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ..._typing import PyTree
from .program import wide

# Lanes for one log or one call, bound by the length of its chain of operations, so that
# more of them gain nothing.
ONE = (2,)


def shape_of(x: np.ndarray, drop: int = 0) -> jax.ShapeDtypeStruct:
    """Of an array without its first axes."""
    return jax.ShapeDtypeStruct(x.shape[drop:], x.dtype)


def key_of(static: PyTree, shapes: PyTree, *more: Any) -> tuple[Any, ...]:
    """Of what a program depends on: the `static` parts of its functions, the shapes and
    types of its inputs, `more`, and the precision of JAX. It may not be hashable."""
    parts, structure = jax.tree.flatten(static)
    leaves, tree = jax.tree.flatten(shapes)
    of_leaves = tuple((s.shape, np.dtype(s.dtype)) for s in leaves)
    return tuple(parts), structure, of_leaves, tree, *more, wide()


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
