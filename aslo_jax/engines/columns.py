"""Columns of numbers, one for each entry of a leaf, as kernels read and write them."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import PyTree


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


def gathered(columns: list[np.ndarray], tree: PyTree, lanes: int) -> PyTree:
    """A tree whose leaves have the axis of lanes first, then that of rows where there is
    one, from a column for each of their entries."""
    leaves, structure = jax.tree.flatten(tree)
    found, first = [], 0
    for s in leaves:
        size = int(np.prod(s.shape, dtype=int))
        group = columns[first : first + size]
        first += size
        lead = (lanes, *columns[0].shape[:-1]) if columns else (lanes,)
        leaf = np.empty((*lead, size), s.dtype)
        for k, column in enumerate(group):
            leaf[..., k] = column[..., :lanes].T
        found.append(leaf.reshape(*lead, *s.shape))
    return jax.tree.unflatten(structure, found)
