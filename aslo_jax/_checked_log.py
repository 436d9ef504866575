"""A log whose shapes, instants and values have been checked."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ._checks import is_concrete, number, real
from ._filled import filled
from ._typing import PyTree

PIECE = 1 << 20  # instants looked at at once
Checked = tuple[Any, PyTree, PyTree, Any]  # the first instant (s), u, y, and intervals (s)


def checked_log(
    t: ArrayLike,
    u: PyTree[ArrayLike],
    y: PyTree[ArrayLike],
    max_gap: float | None = None,
    missing: str = "refuse",
) -> tuple[Checked, Any]:
    """A log whose shapes, instants and values are as [`replay`][] wants them, for
    `run_log`, and its interval (s) if there is a common one."""
    u, y = _signal("u", u), _signal("y", y)
    # Concrete instants keep the precision they came with until intervals are taken: JAX's
    # single precision resolves 1 ms after 10,000 s.
    instants = np.asarray(t) if is_concrete(t) else jnp.asarray(t)
    if instants.dtype.kind not in "fiu":
        raise ValueError(
            f"Argument `t` must hold instants (s), real numbers, but got {instants.dtype}."
        )
    if max_gap is not None:
        number("max_gap", max_gap, "s")
        if not max_gap > 0:
            raise ValueError(f"Argument `max_gap` must be positive (s), but got {max_gap}.")
    _check_shapes(instants, u, y)
    instants = _check_time(instants, max_gap)
    interval = common_interval(instants)
    if missing == "refuse":
        u, y = _check_finite("u", u), _check_finite("y", y)
    elif missing == "interpolate":
        # The last u belongs to no interval.
        u, y = filled("u", u, instants, 1), filled("y", y, instants, 0)
    if interval is None:
        xp = np if is_concrete(instants) else jnp
        intervals, common = real(xp.diff(instants)), None
    else:
        intervals, common = None, real(interval)
    return (real(instants[0]), u, y, intervals), common


def common_interval(t: Any) -> float | None:
    """The interval of evenly spaced instants, or `None` where they are uneven or traced."""
    if not is_concrete(t):
        return None
    largest = max(abs(t[0]), abs(t[-1]))  # it increases
    rounding = 4 * np.finfo(t.dtype).eps * largest if t.dtype.kind == "f" else 0
    interval = float(t[-1] - t[0]) / (t.size - 1)
    for first in range(0, t.size, PIECE):  # a long log is not held several times
        piece = t[first : first + PIECE]
        even = t[0] + interval * np.arange(first, first + piece.size)
        if not np.abs(piece - even.astype(t.dtype)).max() <= rounding:
            return None
    return interval if interval > 0 else None


def _signal(name: str, signal: PyTree) -> PyTree:
    """Arrays of real numbers."""
    for leaf in jax.tree.leaves(signal):
        if not hasattr(leaf, "dtype"):
            raise ValueError(
                f"Argument `{name}` must hold arrays, but one of its leaves is the "
                f"{type(leaf).__name__} {leaf!r}; convert a list by `np.asarray`."
            )
        if np.issubdtype(leaf.dtype, np.complexfloating):
            raise ValueError(
                f"Argument `{name}` must be real, but got {leaf.dtype}; stack real and "
                "imaginary parts, alpha and beta, along the last axis."
            )
    return jax.tree.map(lambda leaf: real(leaf, name), signal)


def _check_shapes(t: Array | np.ndarray, u: PyTree, y: PyTree) -> None:
    if t.ndim != 1 or t.shape[0] < 2:
        raise ValueError(
            "Argument `t` must be a vector of at least two instants, but got shape "
            f"{t.shape}."
        )
    for name, signal in (("u", u), ("y", y)):
        for leaf in jax.tree.leaves(signal):
            if leaf.ndim == 0 or leaf.shape[0] != t.shape[0]:
                raise ValueError(
                    f"Argument `{name}` must have one row for each of the "
                    f"{t.shape[0]} instants of `t`, but got shape {leaf.shape}."
                )


def _check_time(t: Any, max_gap: float | None) -> Any:
    limit = jnp.inf if max_gap is None else max_gap
    if not is_concrete(t):
        gaps = jnp.diff(t)
        t = eqx.error_if(
            t,
            ~jnp.all(jnp.isfinite(t)) | ~jnp.all(gaps > 0),
            "Argument `t` must be finite and strictly increasing.",
        )
        return eqx.error_if(
            t,
            jnp.any(gaps > limit),
            f"Argument `t` must have no gap longer than `max_gap` = {max_gap} s.",
        )
    times = t
    if not np.isfinite(times).all():
        row = int(np.argmin(np.isfinite(times)))
        raise ValueError(
            f"Argument `t` must be finite, but t[{row}] = {times[row]}; remove or repair "
            "that row."
        )
    gaps = np.diff(times)
    if not (gaps > 0).all():
        row = int(np.argmin(gaps > 0)) + 1
        raise ValueError(
            f"Argument `t` must be strictly increasing, but t[{row}] = {times[row]} s "
            f"follows {times[row - 1]} s; sort the log and drop repeated rows."
        )
    if (gaps > limit).any():
        row = int(np.argmax(gaps > limit)) + 1
        raise ValueError(
            f"Argument `t` must have no gap longer than `max_gap` = {max_gap} s, but "
            f"t[{row}] = {times[row]} s follows {times[row - 1]} s; split the log there "
            "or raise `max_gap`."
        )
    return t


def _check_finite(name: str, signal: PyTree) -> PyTree:
    def check(path, leaf):
        where = f"{name}{jax.tree_util.keystr(path)}"
        if not is_concrete(leaf):
            return eqx.error_if(
                leaf, ~jnp.all(jnp.isfinite(leaf)), f"Argument `{where}` must be finite."
            )
        finite = np.isfinite(np.asarray(leaf))
        if not finite.all():
            index = tuple(int(i) for i in np.argwhere(~finite)[0])
            raise ValueError(
                f"Argument `{where}` must be finite, but row {index[0]} holds "
                f"{where}[{', '.join(map(str, index))}] = {leaf[index]}; remove or repair "
                "that row."
            )
        return leaf

    return jax.tree_util.tree_map_with_path(check, signal)
