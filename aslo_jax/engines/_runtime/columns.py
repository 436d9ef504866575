"""Columns of numbers, one for each entry of a leaf, as kernels read and write them
(transposition to a structure of arrays)."""

from collections.abc import Callable

import jax
import numpy as np

from ..._typing import PyTree


def stored(dtype: np.dtype) -> np.dtype:
    return np.dtype(np.uint8) if dtype == np.bool_ else dtype


def _columns(tree: PyTree, padded: int) -> list[np.ndarray]:
    """Every entry of every leaf as a contiguous array over the lanes, the last lane
    repeated up to `padded`."""
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        flat = leaf.reshape(len(leaf), -1).astype(stored(leaf.dtype), copy=False)
        wide = np.empty((flat.shape[1], padded), flat.dtype)
        wide[:, : len(flat)] = flat.T
        wide[:, len(flat) :] = flat[-1:].T
        found += list(wide)
    return found


def _shared(tree: PyTree, padded: int) -> list[np.ndarray]:
    return [
        np.array([x], stored(np.asarray(leaf).dtype))
        for leaf in jax.tree.leaves(tree)
        for x in np.asarray(leaf).reshape(-1)
    ]


def _logs(tree: PyTree, padded: int) -> list[np.ndarray]:
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        rows = leaf.reshape(len(leaf), -1).astype(stored(leaf.dtype), copy=False)
        found += [np.ascontiguousarray(rows[:, k]) for k in range(rows.shape[1])]
    return found


def _lane_logs(tree: PyTree, padded: int) -> list[np.ndarray]:
    """Of leaves with axes of lanes and of steps: rows of steps, columns of lanes."""
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        rows = leaf.reshape(*leaf.shape[:2], -1).astype(stored(leaf.dtype), copy=False)
        for k in range(rows.shape[2]):
            wide = np.empty((leaf.shape[1], padded), rows.dtype)
            wide[:, : len(leaf)] = rows[:, :, k].T
            wide[:, len(leaf) :] = rows[-1:, :, k].T
            found.append(wide)
    return found


# From a tree of a kind and the number of lanes to its columns.
COLUMNS: dict[str, Callable[[PyTree, int], list[np.ndarray]]] = {
    "shared": _shared,
    "lane": _columns,
    "log": _logs,
    "lane log": _lane_logs,
}


def blank(tree: PyTree, *axes: int) -> PyTree:
    """For results with the shapes and types of a tree: of every leaf an array, the axes of
    its columns behind its own."""
    return jax.tree.map(lambda s: np.empty((*s.shape, *axes), stored(s.dtype)), tree)


def columns_of(arrays: PyTree, axes: int) -> list[np.ndarray]:
    """One for each entry of [`blank`][] arrays of columns with so many axes."""
    leaves = ((a, a.shape[: a.ndim - axes]) for a in jax.tree.leaves(arrays))
    return [a[index] for a, own in leaves for index in np.ndindex(own)]


def gathered(arrays: PyTree, tree: PyTree, lanes: int) -> PyTree:
    """The results in [`blank`][] arrays, with the axis of lanes first, then that of rows
    where there is one: views."""

    def lanes_first(a: np.ndarray, s: jax.ShapeDtypeStruct) -> np.ndarray:
        own = range(len(s.shape))
        axes = reversed(range(len(s.shape), a.ndim))
        return a[..., :lanes].view(s.dtype).transpose(*axes, *own)

    return jax.tree.map(lanes_first, arrays, tree)
