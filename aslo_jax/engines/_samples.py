"""Samples of a batch, as a runner takes them: like the one that it was made for."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import random
from .._checks import is_concrete
from .._typing import PyTree

# Each may stand for those before it.
KINDS = (jnp.bool_, jnp.integer, jnp.floating, jnp.complexfloating)


def arrays(samples: PyTree) -> PyTree:
    """With an array for every leaf, in the byte order of the host; of keys, their words."""
    samples = words(samples)
    if all(map(_plain, jax.tree.leaves(samples))):
        return samples
    return jax.tree_util.tree_map_with_path(_array, samples)


def words(samples: PyTree) -> PyTree:
    """With the words of every key, on which all engines compute."""
    return jax.tree.map(_words, samples)


def _words(x: Any) -> Any:
    dtype = getattr(x, "dtype", None)
    if dtype is None or not jnp.issubdtype(dtype, jax.dtypes.prng_key):
        return x
    if isinstance(x, jax.ShapeDtypeStruct):
        return jax.eval_shape(jax.random.key_data, x)
    return random.as_key(x)


def shape_of(x: Any) -> jax.ShapeDtypeStruct:
    """Of one sample, in single precision where JAX is, as the samples will be."""
    x = x if isinstance(x, jax.ShapeDtypeStruct) else jnp.asarray(x)
    dtype = jax.dtypes.canonicalize_dtype(x.dtype, allow_extended_dtype=True)
    return jax.ShapeDtypeStruct(x.shape, dtype)


def lanes_of(samples: PyTree) -> int:
    """How many they are."""
    leaves = jax.tree.leaves(samples)
    sizes = {leaf.shape[0] if leaf.ndim else -1 for leaf in leaves}
    if len(sizes) != 1 or -1 in sizes:
        raise ValueError(
            "Argument `parameters` must have one leading axis of common length in every "
            f"leaf, but got the shapes {[leaf.shape for leaf in leaves]}."
        )
    return sizes.pop()


def fitted(samples: PyTree, like: PyTree) -> PyTree:
    """[`arrays`][] of the types of `like`, the shapes of one sample.

    **Raises:** `ValueError` for another tree, other shapes, or numbers that are others in
    those types, rounding of real numbers apart."""
    tree, expected = jax.tree.structure(samples), jax.tree.structure(like)
    if tree != expected:
        raise ValueError(
            f"Argument `parameters` must have the structure of `like`, {expected}, but got "
            f"{tree}."
        )
    lanes_of(samples)
    pairs = zip(jax.tree.leaves(samples), jax.tree.leaves(like), strict=True)
    if all(x.shape[1:] == s.shape and x.dtype == s.dtype for x, s in pairs):
        return samples
    return jax.tree_util.tree_map_with_path(_fitted, samples, like)


def _plain(x: Any) -> bool:
    if type(x) is np.ndarray:
        return x.dtype.isnative and x.dtype.kind in "biufc"
    return isinstance(x, jax.Array)


def _where(path: Any) -> str:
    return f"`parameters{jax.tree_util.keystr(path)}`"


def _array(path: Any, x: Any) -> Any:
    if not isinstance(x, np.ndarray | jax.Array):
        try:
            x = jnp.asarray(x)
        except (TypeError, ValueError):
            raise ValueError(
                f"Argument {_where(path)} must be an array of numbers, but got {x!r}."
            ) from None
    if isinstance(x, np.ndarray) and not x.dtype.isnative:
        x = x.astype(x.dtype.newbyteorder("="))
    if _kind(x.dtype) < 0 and not jnp.issubdtype(x.dtype, jax.dtypes.extended):
        raise ValueError(
            f"Argument {_where(path)} must be an array of numbers, but got the type "
            f"{x.dtype}."
        )
    return x


def _kind(dtype: Any) -> int:
    found = (k for k, kind in enumerate(KINDS) if jnp.issubdtype(dtype, kind))
    return next(found, -1)


def _fitted(path: Any, x: Any, s: jax.ShapeDtypeStruct) -> Any:
    if x.shape[1:] != s.shape:
        wanted = ", ".join(map(str, ("N", *s.shape)))
        raise ValueError(
            f"Argument {_where(path)} must have the shape ({wanted}), one axis before "
            f"those of `like`, but got {x.shape}."
        )
    if x.dtype == s.dtype:
        return x
    source, target = _kind(x.dtype), _kind(s.dtype)
    if source < 0 or source > target:
        raise ValueError(
            f"Argument {_where(path)} must have the type {s.dtype} of `like`, or one that "
            f"it comprises, but got {x.dtype}."
        )
    converted = jnp.asarray(x, s.dtype) if isinstance(x, jax.Array) else x.astype(s.dtype)
    if source < 2 and is_concrete(x):  # not a real number, which may be rounded
        _exact(path, np.asarray(x), np.asarray(converted))
    return converted


def _exact(path: Any, x: np.ndarray, converted: np.ndarray) -> None:
    with np.errstate(invalid="ignore"):
        back = np.real(converted).astype(x.dtype)
    same = (back == x) & ((np.real(converted) < 0) == (x < 0))
    if not same.all():
        raise ValueError(
            f"Argument {_where(path)} must hold numbers that the type {converted.dtype} of "
            f"`like` holds exactly, but got {x[~same][0]}."
        )
