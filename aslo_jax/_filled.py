"""Missing samples of a log, put between their neighbours."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._checks import is_concrete
from ._typing import PyTree


def filled(name: str, signal: PyTree, t: Any, held: int) -> PyTree:
    """Every entry that is not finite on the line between those before and after it in its
    column, or for an input, each of which is `held`, between the middles of intervals."""

    def join(path, leaf):
        where = f"{name}{jax.tree_util.keystr(path)}"
        concrete = is_concrete(leaf) and is_concrete(t)
        xp = np if concrete else jnp
        columns = xp.asarray(leaf).reshape(leaf.shape[0], -1)
        if concrete and not np.isfinite(columns).any(axis=0).all():
            raise ValueError(
                f"Argument `{where}` must have a finite entry in every column for "
                '`missing="interpolate"`, but one of them has none.'
            )
        ends = xp.asarray(t)
        last = xp.concatenate([ends[1:], 2 * ends[-1:] - ends[-2:-1]])
        at = 0.5 * (ends + last) if held else ends
        lines = [_line(xp, at, column) for column in columns.T]
        return xp.stack(lines, axis=1).reshape(leaf.shape)

    return jax.tree_util.tree_map_with_path(join, signal)


def _line(xp: Any, t: Any, x: Any) -> Any:
    """x, where it is not finite on the line between its neighbours."""
    there, rows = xp.isfinite(x), xp.arange(x.shape[0])
    known = xp.where(there, x, 0.0)
    if xp is np:
        before = np.maximum.accumulate(np.where(there, rows, -1))
        after = np.minimum.accumulate(np.where(there, rows, x.shape[0])[::-1])[::-1]
    else:
        before = jax.lax.cummax(jnp.where(there, rows, -1))
        after = jax.lax.cummin(jnp.where(there, rows, x.shape[0]), reverse=True)
    low = xp.where(before < 0, after, before)
    high = xp.where(after == x.shape[0], before, after)
    low, high = xp.clip(low, 0, x.shape[0] - 1), xp.clip(high, 0, x.shape[0] - 1)
    gap = xp.where(high > low, t[high] - t[low], 1.0)
    part = ((t - t[low]) / gap * (high > low)).astype(x.dtype)
    return xp.where(there, x, known[low] + part * (known[high] - known[low]))
