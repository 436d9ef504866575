"""Adaptive solves that differ by a number."""

import importlib.util
import threading
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from .._experiment import Experiment, Record
from .._replay import replay
from .._typing import PyTree
from ..engines import run_batch
from ..observers import AbstractObserver

# A batch is a callback of JAX, which waits on a thread of XLA's pool: several at a time may
# occupy all of them, and wait for each other.
_CALLBACKS = threading.Lock()


def one_by_one(one: Callable[[PyTree], PyTree], over: PyTree) -> PyTree:
    """What `jax.vmap(one)(over)` gives, as NumPy arrays. An adaptive solve takes twice as
    long to compile for a batch."""
    run, count = jax.jit(one), len(jax.tree.leaves(over)[0])
    each = [run(jax.tree.map(lambda x, k=k: x[k], over)) for k in range(count)]
    return jax.tree.map(lambda *x: np.stack(x), *each)


def is_fused() -> bool:
    """Whether the fused engine is installed."""
    return importlib.util.find_spec("llvmlite") is not None


def tight(
    rtol: float = 1e-9, atol: float = 1e-12, first: float | None = None
) -> dict[str, Any]:
    """Options of `simulate` for [`solved`][] and [`batch`][]: filter states are tiny at
    first and count all the same. The `first` step (s) of diffrax; the fused engine finds
    its own."""
    if is_fused():
        return dict(rtol=rtol, atol=atol, engine="fused", max_steps=1_000_000)
    return dict(
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
        max_steps=1_000_000,
        dt0=first,
        adjoint=diffrax.ForwardMode(),  # compiles faster
    )


def solved(run: Callable[[], PyTree]) -> PyTree:
    """One simulation as NumPy arrays."""
    found = run() if is_fused() else jax.jit(run)()
    return jax.tree.map(np.asarray, found)


def batch(one: Callable[[PyTree], PyTree], over: PyTree) -> PyTree:
    """What `jax.vmap(one)(over)` gives, as NumPy arrays: the lanes of one fused loop. What
    `one` hands to `simulate` holds what it is given in modules, not in closures."""
    if not is_fused():
        return one_by_one(one, over)
    with _CALLBACKS:
        return jax.tree.map(np.asarray, jax.vmap(one)(jax.tree.map(jnp.asarray, over)))


def sampled(
    make: Callable[[PyTree], Experiment],
    samples: PyTree,
    steps: int,
    record: Callable[[Record], PyTree],
    every: int = 1,
) -> PyTree:
    """What `record` keeps of every `every`-th sample of the experiments `make(sample)`, as
    NumPy arrays of shape (lanes, N, ...)."""
    engine = "fused" if is_fused() else "scan"
    settings: dict[str, Any] = dict(record=record, every=every, engine=engine)
    found = run_batch(make, samples, steps, **settings).record
    return jax.tree.map(np.asarray, found)


def by_logs(
    make: Callable[[PyTree, Any], AbstractObserver[Any]], interval: float
) -> Callable:
    """The values of the estimates of observers `make(sample, y)`, y the first one of a log
    sampled every `interval` s: a function of samples and of u and y, shape (lanes, N, ...),
    beside each other in one loop; by name where the observer is several."""

    def values(estimate):
        if isinstance(estimate, dict):
            return {name: each.value for name, each in estimate.items()}
        return estimate.value

    if is_fused():
        from ..engines._fused.replays import Replays

        return Replays(make, values, interval)

    @jax.jit
    def run(samples, u, y):
        t = interval * np.arange(y.shape[1])
        one = lambda sample, u, y: replay(make(sample, y[0]), t, u, y, engine="scan")
        return values(jax.vmap(one)(samples, u, y))

    return lambda *given: jax.tree.map(np.asarray, run(*given))
