"""From a log and a machine to the table of estimates."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..logs import Log
from ..machines import AbstractDescription, Quantity
from ..machines.base import Columns, Rates, relative
from ..observers import AbstractObserver, PhaseLockedLoop, wrap
from ..replay import replay

PIECE = 50_000  # rows replayed at once


@dataclasses.dataclass(frozen=True)
class Result:
    """The estimates of a log of `N` rows.

    - `columns`: the table, each column of shape `(N,)`;
    - `truth`: the truth by the names of that table;
    - `rates`: those of the observer, by key; `substeps` per sampling interval.
    """

    columns: Columns
    truth: Columns
    rates: Rates
    substeps: int

    def start(self, suffix: str) -> int | None:
        """The row of the first certified estimate, `None` where there is none."""
        coasting = self.columns[f"coasting{suffix}"]
        return None if coasting.all() else int(np.argmin(coasting))

    def settled(self, suffix: str) -> Bool[np.ndarray, " N"]:
        """The rows that a summary counts: from ten time constants after the first
        certified estimate on, or from that one in a short log. The time constant is that
        of loop and gain, which forget their start, or else of the fastest filter."""
        t, start = self.columns["t"], self.start(suffix)
        if start is None:
            return np.zeros(t.size, bool)
        loops = [self.rates[k].value for k in ("gain", "pll_bandwidth") if k in self.rates]
        rate = min(loops) if loops else max(rate.value for rate in self.rates.values())
        rows = t >= t[start] + 10.0 / rate
        return rows if rows.any() else t >= t[start]

    def relative_error(self, quantity: Quantity) -> Float[np.ndarray, " N"] | None:
        """`|error| / |truth|` of a quantity row by row, where all its truth is known; of a
        scalar, which may go through zero, over the rms of its truth."""
        if not set(quantity.columns) <= self.truth.keys():
            return None
        error = np.stack([self.columns[f"error_{name}"] for name in quantity.columns])
        size = np.linalg.norm([self.truth[name] for name in quantity.columns], axis=0)
        if len(quantity.columns) == 1:
            size = np.full_like(size, np.sqrt(np.mean(size**2)))
        return relative(np.linalg.norm(error, axis=0), size)


def estimate_log(
    log: Log,
    machine: AbstractDescription,
    rates: Rates,
    substeps: int = 4,
    progress: Callable[[int], Any] = lambda rows: None,
) -> Result:
    """Run the observer of a machine over a log, and a phase-locked loop where it has an
    angle. `progress` is told of rows as they are done.

    The columns are `t` (s), the quantities of the machine, `certificate` and `coasting`
    with every suffix, and where the log has truth the errors, estimate less truth.
    """
    observer = machine.state_observer(rates)
    estimate = in_pieces(observer, log.t, log.u, log.y, substeps, progress)
    found = machine.columns(estimate, log)
    for quantity in machine.quantities:
        if quantity.tracks is not None:
            # The first certified row; where there is none argmin gives the first one.
            start = int(np.argmin(found[f"coasting{quantity.suffix}"]))
            angle, bandwidth = found[quantity.tracks], rates["pll_bandwidth"].value
            found[quantity.columns[0]] = _speed(log.t, angle, start, bandwidth)
    suffixes = machine.suffixes()
    names = [name for quantity in machine.quantities for name in quantity.columns]
    names += [f"certificate{suffix}" for suffix in suffixes]
    names += [f"coasting{suffix}" for suffix in suffixes]
    truth = machine.truth(log)
    columns = {"t": log.t} | {name: found[name] for name in names}
    angles = [q.columns[0] for q in machine.quantities if q.angle]
    for name in truth:
        error = columns[name] - truth[name]
        columns[f"error_{name}"] = _wrapped(error) if name in angles else error
    return Result(columns, truth, rates, substeps)


def in_pieces(
    observer: AbstractObserver,
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N ..."],
    y: Float[np.ndarray, "N ..."],
    substeps: int = 1,
    progress: Callable[[int], Any] = lambda rows: None,
) -> Any:
    """[`replay`][] piece by piece, which gives the same estimates.

    Pieces overlap by one sample and have at most two lengths, so that at most two are
    compiled. Time is taken from the start of each, so that it keeps its digits."""
    intervals = t.size - 1
    pieces = math.ceil(intervals / PIECE)
    edges = np.linspace(0, intervals, pieces + 1).astype(int)
    state, done = observer.init(y[0], u[0]), []
    for first, last in itertools.pairwise(edges):
        rows = slice(first, last + 1)
        estimate, state = _piece(
            observer, state, t[rows] - t[first], u[rows], y[rows], substeps
        )
        new = jax.tree.map(np.asarray, estimate)
        done.append(jax.tree.map(lambda x: x[1:], new) if done else new)
        progress(int(last - first))
    return jax.tree.map(lambda *x: np.concatenate(x), *done)


@eqx.filter_jit
def _piece(observer, state, t, u, y, substeps):
    return replay(observer, t, u, y, substeps=substeps, state=state, return_state=True)


def _speed(
    t: Float[np.ndarray, " N"],
    angle: Float[np.ndarray, " N"],
    first: int,
    bandwidth: float,
) -> Float[np.ndarray, " N"]:
    """The speed (rad/s) of an angle (rad) that counts from row `first`, before it zero.

    It is `w + 2 b e` of the loop's state w and angle error e: unlike w alone, it does not
    lag under constant acceleration."""
    speed = np.zeros_like(t)
    if t.size - first < 2:
        return speed
    t, angle = t[first:], angle[first:]
    loop = in_pieces(PhaseLockedLoop(bandwidth), t, np.zeros_like(t), angle)
    error = _wrapped(angle - loop.value[:, 0])
    speed[first:] = loop.value[:, 1] + 2.0 * bandwidth * error
    return speed


def _wrapped(angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    return np.asarray(wrap(jnp.asarray(angle)))
