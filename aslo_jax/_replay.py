"""Running an observer over a recorded log."""

import importlib.util
import warnings
from typing import Any, Literal, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from . import _choices
from ._checks import is_concrete, kind, one_of, real
from ._typing import Engine, Missing, PyTree
from .observers import AbstractObserver, Estimate, ObserverState
from .observers._base import Est
from .observers._missing import either, finite, marked, zeros

PIECE = 1 << 20  # instants looked at at once
Checked = tuple[Any, PyTree, PyTree, Any]  # the first instant (s), u, y, and intervals (s)


@overload
def replay(
    observer: AbstractObserver[Est],
    t: ArrayLike,
    u: PyTree,
    y: PyTree,
    *,
    substeps: int = 1,
    state: ObserverState | None = None,
    return_state: Literal[False] = False,
    max_gap: float | None = None,
    engine: Engine = "scan",
) -> Est: ...


@overload
def replay(
    observer: AbstractObserver[Est],
    t: ArrayLike,
    u: PyTree,
    y: PyTree,
    *,
    substeps: int = 1,
    state: ObserverState | None = None,
    return_state: Literal[True],
    max_gap: float | None = None,
    engine: Engine = "scan",
) -> tuple[Est, ObserverState]: ...


@overload
def replay(
    observer: AbstractObserver[Est],
    t: ArrayLike,
    u: PyTree,
    y: PyTree,
    *,
    substeps: int = 1,
    state: ObserverState | None = None,
    return_state: bool,
    max_gap: float | None = None,
    engine: Engine = "scan",
) -> Est | tuple[Est, ObserverState]: ...


def replay(
    observer: AbstractObserver[Est],
    t: ArrayLike,
    u: PyTree,
    y: PyTree,
    *,
    substeps: int = 1,
    state: ObserverState | None = None,
    return_state: bool = False,
    max_gap: float | None = None,
    engine: Engine = "scan",
    missing: Missing = "refuse",
) -> Est | tuple[Est, ObserverState]:
    """Run an observer over a log: arrays in, arrays out.

    `y[k]` is sampled at `t[k]` (s) and `u[k]` is held on `[t[k], t[k+1])`, so the last u
    is unused. The estimate at `t[k]` uses nothing later than `y[k]`; `estimate[0]` is the
    initial guess, which an observer with a guard flags as coasting.

    **Arguments:**

    - `t`, shape `(N,)`; `u` and `y`, arrays or trees of them with a leading axis of
      length `N`, in the units of the observer's relation;
    - `substeps`: split each interval with interpolated y, where products of signals curve
      within it;
    - `state`: resume from this state, left by an earlier piece of the same log whose last
      sample is the first sample of this one;
    - `return_state`: return `(estimate, state)`;
    - `max_gap`: refuse a log with a longer interval (s);
    - `engine`: `"scan"` is one `jax.lax.scan`; `"fused"` compiles the loop to machine code
      (the extra `cli` or `study`), many times faster, without derivatives; `jax.vmap` runs
      many logs beside each other in it. `"auto"` is `"fused"` where that extra is installed
      and no argument is traced by a transformation of JAX, so that derivatives and
      `jax.jit` are as with `"scan"`; an observer that cannot be compiled runs by `"scan"`,
      with a warning that says why;
    - `missing`: what becomes of a row of u or y with an entry that is not finite.
      `"refuse"` names it; `"coast"` takes it as missing, sample by sample, exactly as
      [`AbstractObserver.step`][] does: the estimate coasts, and is flagged; `"interpolate"`
      puts it on the line between the finite entries before and after it in its column (at
      the ends of the log, holds the nearest), and flags nothing, for holes that are short
      beside every motion. It looks ahead, which `step` cannot.

    Intervals equal to within rounding share their coefficients, computed once; otherwise
    each interval has its own. Compiled once for each structure of observer and log.

    **Returns:** an [`Estimate`][] whose leaves have a leading axis of length `N`.
    Differentiable unless `engine="fused"`; `jax.vmap` maps it over logs, initial states and
    parameters.

    **Raises:** `ValueError` (or, under `jax.jit`, an error from `eqx.error_if`) for
    shapes that differ, a sample that is not finite where that is refused, time that does
    not increase, or a gap above `max_gap`; [`NotFusible`][] for an observer that the fused
    engine cannot compile.
    """
    one_of("engine", engine, _choices.Engine)
    kind("observer", observer, AbstractObserver, hint="an observer")
    one_of("missing", missing, _choices.Missing)
    log, common = checked_log(t, u, y, max_gap, missing)
    coasts = missing == "coast" or _amid(state)
    estimate, final = run_log(observer, log, common, substeps, state, engine, coasts)
    return (estimate, final) if return_state else estimate


def checked_log(
    t: ArrayLike,
    u: PyTree[ArrayLike],
    y: PyTree[ArrayLike],
    max_gap: float | None = None,
    missing: str = "refuse",
) -> tuple[Checked, Any]:
    """A log whose shapes, instants and values are as [`replay`][] wants them, for
    [`run_log`][], and its interval (s) if there is a common one."""
    u, y = _signal("u", u), _signal("y", y)
    # Concrete instants keep the precision they came with until intervals are taken: JAX's
    # single precision resolves 1 ms after 10,000 s.
    instants = np.asarray(t) if is_concrete(t) else jnp.asarray(t)
    _check_shapes(instants, u, y)
    instants = _check_time(instants, max_gap)
    interval = common_interval(instants)
    if missing == "refuse":
        u, y = _check_finite("u", u), _check_finite("y", y)
    elif missing == "interpolate":
        # The last u belongs to no interval.
        u, y = _joined("u", u, instants, 1), _joined("y", y, instants, 0)
    if interval is None:
        xp = np if is_concrete(instants) else jnp
        intervals, common = real(xp.diff(instants)), None
    else:
        intervals, common = None, real(interval)
    return (real(instants[0]), u, y, intervals), common


def run_log(
    observer: AbstractObserver[Est],
    log: Checked,
    common: Any,
    substeps: int,
    state: ObserverState | None,
    engine: Engine,
    coasts: bool = False,
) -> tuple[Est, ObserverState]:
    """[`replay`][] of a `log` that has been checked: its first instant, u, y, and its
    intervals (s) where they have no length in `common`; `coasts`: whether samples may be
    missing in it."""
    if engine == "auto" and not _may_fuse((observer, log, common, state)):
        engine = "scan"
    if engine == "scan":
        return _run(observer, log, common, substeps, state, coasts)
    from .engines._frontend.lower import NotFusible

    try:
        return _run_fused(observer, log, common, substeps, state, coasts)
    except NotFusible as error:
        if engine == "fused":
            raise
        warnings.warn(f'Running with engine="scan". {error}', stacklevel=3)
        return _run(observer, log, common, substeps, state, coasts)


def _amid(state: ObserverState | None) -> bool:
    """Whether a state may have been left where samples are missing."""
    if state is None or state.gap is None:
        return False
    weight, doubt = state.gap.weight, state.gap.doubt
    if not is_concrete(weight, doubt):
        return True
    return bool(np.any(np.asarray(weight) != 1.0) or np.any(np.asarray(doubt) > 0.0))


def _may_fuse(arguments: PyTree) -> bool:
    """Whether nothing is traced, and LLVM is there."""
    concrete = is_concrete(*jax.tree.leaves(arguments))
    return concrete and importlib.util.find_spec("llvmlite") is not None


@eqx.filter_jit
def _run(
    observer: AbstractObserver[Est],
    log: Checked,
    common: Array | None,
    substeps: int,
    state: ObserverState | None,
    coasts: bool,
) -> tuple[Est, ObserverState]:
    t0, u, y, intervals = log
    u0, y0 = jax.tree.map(lambda s: s[0], (u, y))
    if state is None:
        state = observer.init(y0, u0)
    first = _first(observer, t0, state, u0, y0, coasts)
    laws = observer.allocate(y0, u0)
    coefficients = None if common is None else laws.discretise(common / substeps)

    def body(state, sample):
        u, y, h = sample
        own = laws.discretise(h / substeps) if coefficients is None else coefficients
        if coasts:
            dt: Any = common if h is None else h
            return observer.take(state, u, y, dt, own, substeps=substeps)
        return observer.advance(state, u, y, own, substeps=substeps)

    held, sampled = jax.tree.map(lambda s: s[:-1], u), jax.tree.map(lambda s: s[1:], y)
    final, rest = jax.lax.scan(body, state, (held, sampled, intervals))
    estimate = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)
    return estimate, final


def _run_fused(
    observer: AbstractObserver[Est],
    log: Checked,
    common: Any,
    substeps: int,
    state: ObserverState | None,
    coasts: bool,
) -> tuple[Est, ObserverState]:
    from .engines._fused.replay import replay_fused  # which needs an extra

    t0, u, y, intervals = log
    # NumPy cuts and joins what can be read; XLA would compile a program for each.
    read = is_concrete(*jax.tree.leaves((observer, log, common, state)))
    xp = np if read else jnp
    u, y = jax.tree.map(xp.asarray, (u, y))
    u0, y0 = jax.tree.map(lambda s: s[0], (u, y))
    interval = None if common is None else common / substeps
    arguments = observer, t0, u0, y0, state, interval, coasts
    begun = _begun_by_machine_code if read else _begun
    state, first, coefficients = begun(*arguments)
    held, sampled = jax.tree.map(lambda s: s[:-1], u), jax.tree.map(lambda s: s[1:], y)
    assert state is not None
    rest, final = replay_fused(
        observer,
        state,
        held,
        sampled,
        intervals,
        coefficients,
        substeps,
        jnp.asarray(common) if coasts and common is not None else None,
        coasts,
    )

    def joined(a: Any, b: Any) -> Any:
        return xp.concatenate([xp.asarray(a)[None], xp.asarray(b)])

    estimate = jax.tree.map(joined, first, rest)
    return (jax.device_put(estimate) if read else estimate), final


def _begun_by_machine_code(*arguments):
    """What [`_begun`][] gives, without XLA if need not be: for a start it compiles longer
    than the engine for the whole log."""
    from .engines._frontend.lower import NotFusible
    from .engines._fused.once import once

    try:
        return once(_beginning, *arguments)
    except NotFusible:
        return _begun(*arguments)


def _beginning(observer, t0, u, y, state, interval, coasts):
    """The state to begin with, its estimate, and the coefficients for an `interval` (s)."""
    state = observer.init(y, u) if state is None else state
    laws = None if interval is None else observer.allocate(y, u).discretise(interval)
    return state, _first(observer, t0, state, u, y, coasts), laws


_begun = eqx.filter_jit(_beginning)


def _first(observer, t0, state, u, y, coasts):
    """The estimate at the first row, which may be missing; of u it depends on nothing."""
    if not coasts:
        return observer.estimate(t0, state, u, y)
    there = finite(y)
    u = either(finite(u), u, zeros(u))
    y = either(there, observer.continued(state.y, y), state.y)
    return marked(observer.estimate(t0, state, u, y), ~there, Estimate)


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
    return jax.tree.map(real, signal)


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


def _joined(name: str, signal: PyTree, t: Any, held: int) -> PyTree:
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
