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
from ._checked_log import Checked, checked_log
from ._checks import is_concrete, kind, one_of
from ._typing import Engine, Missing, PyTree
from .observers import AbstractObserver, Estimate, ObserverState
from .observers._base import Est, check_states
from .observers._missing import DOUBT, Gap, either, finite, marked, zeros


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
    missing: Missing = "refuse",
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
    missing: Missing = "refuse",
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
    missing: Missing = "refuse",
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
    not increase, a gap above `max_gap`, or the state of another observer;
    [`NotFusible`][] for an observer that the fused engine cannot compile.
    """
    one_of("engine", engine, _choices.Engine)
    kind("observer", observer, AbstractObserver, hint="an observer")
    one_of("missing", missing, _choices.Missing)
    kind("state", state, ObserverState, hint="a state of this observer, from `init`")
    log, common = checked_log(t, u, y, max_gap, missing)
    coasts = missing == "coast" or _amid(state)
    estimate, final = run_log(observer, log, common, substeps, state, engine, coasts)
    return (estimate, final) if return_state else estimate


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
    from ._frontend.lower import NotFusible

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
    state = _started(observer, y0, u0, state, coasts)
    laws = observer.allocate(y0, u0)
    check_states(state.states, laws.states)
    first = _first(observer, t0, state, u0, y0, coasts)
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
    from ._frontend.lower import NotFusible
    from .engines._fused.once import once

    try:
        return once(_beginning, *arguments)
    except NotFusible:
        return _begun(*arguments)


def _beginning(observer, t0, u, y, state, interval, coasts):
    """The state to begin with, its estimate, and the coefficients for an `interval` (s)."""
    begun = observer.allocate(y, u)
    state = _started(observer, y, u, state, coasts)
    check_states(state.states, begun.states)
    laws = None if interval is None else begun.discretise(interval)
    return state, _first(observer, t0, state, u, y, coasts), laws


_begun = eqx.filter_jit(_beginning)


def _started(observer, y, u, state, coasts):
    """The `state` to begin with: where samples may be missing, one that remembers them, as
    one of continuous time does not."""
    if state is None:
        return observer.init(y, u)
    if coasts and state.gap is None:
        return ObserverState(state.states, state.y, Gap.before(u, state.y)[0])
    return state


def _first(observer, t0, state, u, y, coasts):
    """The estimate at the first row, which may be missing, or doubted as by
    [`AbstractObserver.take`][] where the state was left so; of u it depends on nothing."""
    if not coasts:
        return observer.estimate(t0, state, u, y)
    there = finite(y)
    u = either(finite(u), u, zeros(u))
    y = either(there, observer.continued(state.y, y), state.y)
    doubtful = ~there | (state.gap.doubt > DOUBT)
    return marked(observer.estimate(t0, state, u, y), doubtful, Estimate)
