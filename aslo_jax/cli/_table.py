"""From a log and a machine to the table of estimates, piece by piece."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8

from .._checked_log import common_interval
from .._replay import run_log
from .._smooth import smooth
from .._typing import Engine
from ..derivation import StateObserver
from ..diagnosis import Rows, absent_rows, bridged, touched
from ..logs import Log
from ..machines import AbstractDescription, Quantity
from ..machines._base import Columns, Rates
from ..machines._lifted import HELD, is_lifted
from ..observers import (
    AbstractObserver,
    Adaptive,
    Lifted,
    ObserverState,
    PhaseLockedLoop,
    SideBySide,
)
from ..observers._pll import lagless
from ._restarts import Restarted, slowest, stretches

PIECE = 50_000  # rows replayed at once


@dataclasses.dataclass(frozen=True)
class Piece:
    """Rows of the table of estimates.

    - `columns`, each of shape `(N,)`: `t` (s), the quantities of the machine, `certificate`
      and `coasting` with every suffix, `coasting_speed` and the like for what a
      phase-locked loop gives, and where there is truth the errors, estimate less
      truth;
    - `truth`: the truth by the names of that table;
    - `residuals`: those of the machine, by quantity, where there is no truth.
    """

    columns: Columns
    truth: Columns
    residuals: Columns


class Replayed:
    """[`replay`][] of a log that comes in pieces, which gives the same estimates: a piece
    begins with the last row of the one before.

    - `interval` (s): that of an evenly sampled log, `None` otherwise;
    - `slow`: why it runs by the slower engine, if it does.
    """

    def __init__(
        self, observer: AbstractObserver[Any], interval: float | None, substeps: int = 1
    ) -> None:
        self.observer, self.substeps = observer, substeps
        self.interval = None if interval is None else np.asarray(interval)
        self.slow = ""
        self._engine: Engine = "auto"
        self._state: ObserverState | None = None
        self._coasts = False  # from the first sample on that is missing

    def __call__(
        self,
        t: Float[np.ndarray, " N"],
        u: Float[np.ndarray, "N ..."],
        y: Float[np.ndarray, "N ..."],
    ) -> Any:
        """The estimates of a piece, of its first row too."""
        lengths = None if self.interval is not None else np.diff(t)
        log = (np.zeros(()), u, y, lengths)
        there = bool(np.isfinite(u).all() and np.isfinite(y).all())
        self._coasts = self._coasts or not there
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            estimate, self._state = run_log(
                self.observer,
                log,
                self.interval,
                self.substeps,
                self._state,
                self._engine,
                self._coasts,
            )
        if said and self._engine == "auto":
            self.slow, self._engine = str(said[0].message), "scan"
        return jax.tree.map(np.asarray, estimate)

    @property
    def running(self) -> bool:
        """Whether a piece has been run since the start, or since [`Replayed.stop`][]."""
        return self._state is not None

    def stop(self) -> None:
        """Forget everything: the next piece begins anew."""
        self._state = None

    def restarted(
        self,
        t: Float[np.ndarray, " N"],
        u: Float[np.ndarray, "N ..."],
        y: Float[np.ndarray, "N ..."],
        last: Sequence[int],
    ) -> Any:
        """The estimates of a piece in which the observer starts again after the rows
        `last`."""
        parts, first = [], 0
        for end in (*last, t.size - 1):
            rows = slice(first, end + 1)
            if end > first:
                parts.append(self(t[rows], u[rows], y[rows]))
            else:  # one row: the guess that an observer begins with
                twice = np.array([end, end])
                instants = t[end] + np.array([0.0, t[-1] - t[-2]])
                alone = self(instants, u[twice], y[twice])
                parts.append(jax.tree.map(lambda x: x[:1], alone))
            first = end + 1
            if end < t.size - 1 or rows.start == end:
                self.stop()
        return jax.tree.map(lambda *x: np.concatenate(x), *parts)


class Smoothed(Replayed):
    """As [`Replayed`][] with every estimate from the whole of its piece, by [`smooth`][]:
    of a Kalman filter, or of several side by side."""

    def __call__(
        self,
        t: Float[np.ndarray, " N"],
        u: Float[np.ndarray, "N ..."],
        y: Float[np.ndarray, "N ..."],
    ) -> Any:
        observer = self.observer
        each = observer.observers if isinstance(observer, SideBySide) else observer
        leaf = lambda x: isinstance(x, Lifted | Adaptive | StateObserver)
        lost = not (np.isfinite(u).all() and np.isfinite(y).all())
        one = lambda x: smooth(x, t, u, y, missing="coast" if lost else "refuse")
        done = jax.tree.map(one, each, is_leaf=leaf)
        return jax.tree.map(np.asarray, done)


class Estimator:
    """The observer of a machine over a log, and a phase-locked loop for every quantity that
    tracks an angle.

    - `t`: every instant of the log (s), whose pieces come in order;
    - `first`: the row in which the loops start, by default the first certified one;
    - `smoothed`: whether it also looks ahead, in a log that comes in one piece;
    - `observed(t, u, y)`: what gives the estimates of a piece, in place of the machine's
      observer;
    - `offsets`: what is taken from the errors of angles (rad), by column;
    - `starts`: by suffix, the first certified row, once there is one.
    """

    def __init__(
        self,
        machine: AbstractDescription,
        rates: Rates,
        t: Float[np.ndarray, " N"],
        substeps: int = 4,
        first: int | None = None,
        offsets: Mapping[str, float] | None = None,
        smoothed: bool = False,
        observed: Callable[[Any, Any, Any], Any] | None = None,
    ) -> None:
        self.machine, self.starts = machine, dict[str, int]()
        self.offsets = offsets or {}
        interval = common_interval(t)
        if observed is None:
            replayed = Smoothed if smoothed else Replayed
            observed = replayed(machine.state_observer(rates), interval, substeps)
        self.observed: Any = observed
        self._tracked = [q for q in machine.quantities if q.tracks is not None]
        bandwidth = rates["pll_bandwidth"].constant if self._tracked else 0.0
        self._bandwidth = bandwidth
        self._loops = {
            q.name: Replayed(PhaseLockedLoop(bandwidth, wraps=False), interval)
            for q in self._tracked
        }
        self._held = {q.name: 0.0 for q in self._tracked}
        self._fresh = {s: Restarted(slowest(rates)) for s in machine.suffixes()}
        self._rows, self._first = 0, first
        self._last: Columns = {}
        self._before: tuple[Columns, Log] | None = None

    @property
    def complete(self) -> bool:
        """Whether every loop has started."""
        return all(
            self._first is not None or q.suffix in self.starts for q in self._tracked
        )

    def __call__(self, log: Log, suspect: Rows | None = None) -> Piece:
        """The table of a piece of the log, without the row that it shares with the one
        before; `suspect`: its rows that cannot be right and have been repaired."""
        fresh = self._rows == 0
        # The row that this piece begins with.
        begin = 0 if fresh else self._rows - 1
        estimate = self._observed(log, suspect)
        # The observer coasts over what is missing; where its rows are looked at beside the
        # estimates, straight lines stand in.
        log = bridged(log, absent_rows(log))
        found = self.machine.columns(estimate, log)
        if suspect is not None and suspect.count:
            made_up = touched(suspect, log.t.size)
            for suffix in self.machine.suffixes():
                found[f"coasting{suffix}"] = found[f"coasting{suffix}"] | made_up
        parts = stretches(log.t.size, suspect)
        for suffix, fresh_one in self._fresh.items():
            coasting = found[f"coasting{suffix}"]
            found[f"coasting{suffix}"] = fresh_one.doubting(log.t, coasting, parts)
        for quantity in self.machine.quantities:
            if quantity.angle:
                self._continue(found, quantity.columns[0])
        for suffix in self.machine.suffixes():
            trusted = found[f"coasting{suffix}"] == 0
            if suffix not in self.starts and trusted.any():
                self.starts[suffix] = begin + int(np.argmax(trusted))
        for quantity in self._tracked:
            assert quantity.tracks is not None
            found[quantity.columns[0]], away = self._speed(
                quantity,
                log.t,
                found[quantity.tracks],
                found[f"coasting{quantity.suffix}"] == 0,
                parts,
            )
            found[f"coasting_{quantity.name}"] = away | found[f"coasting{quantity.suffix}"]
        self._rows = begin + log.t.size
        truth = self.machine.truth(log)
        whole = self._table(found, log.t, truth)
        shared = 0 if fresh else 1
        residuals = {} if truth else self._residuals(whole, log, log.t.size - shared)
        new = lambda columns: {name: x[shared:] for name, x in columns.items()}
        return Piece(new(whole), new(truth), residuals)

    def _observed(self, log: Log, suspect: Rows | None) -> Any:
        if suspect is None or not suspect.lost.size:
            return self.observed(log.t, log.u, log.y)
        last = [int(row) for row in suspect.lost]
        return self.observed.restarted(log.t, log.u, log.y, last)

    def _continue(self, found: Columns, name: str) -> None:
        """Whole turns more or less, so that an unwrapped angle goes on from the last row of
        the piece before."""
        angle = found[name]
        if name in self._last:
            turns = np.round((self._last[name] - angle[0]) / (2.0 * np.pi))
            angle = found[name] = angle + 2.0 * np.pi * turns
        self._last[name] = angle[-1]

    def _speed(
        self,
        quantity: Quantity,
        t: Float[np.ndarray, " N"],
        angle: Float[np.ndarray, " N"],
        trusted: Bool[np.ndarray, " N"],
        parts: Sequence[slice],
    ) -> tuple[Float[np.ndarray, " N"], UInt8[np.ndarray, " N"]]:
        """The speed (rad/s) of an angle (rad), and where the loop does not yet agree with
        the angle, or no longer does. In each of the `parts` of the piece the loop starts
        anew, in its first row that is `trusted`; until then the speed is the last one, at
        first zero.

        It is `w + 2 b e` of the loop's state w and angle error e: unlike w alone, it does
        not lag under constant acceleration."""
        name, loop = quantity.name, self._loops[quantity.name]
        speed, away = np.full_like(t, self._held[name]), np.ones(t.size, np.uint8)
        for part in parts:
            if part.start:
                loop.stop()
            speed[part] = self._held[name]
            first = part.start
            if not loop.running:
                never = self._first is not None and quantity.suffix not in self.starts
                if trusted[part].any():
                    first += int(np.argmax(trusted[part]))
                elif not never:
                    continue
            rows = slice(first, part.stop)
            if part.stop - first < 2:
                continue
            tracked = loop(t[rows], np.zeros_like(t[rows]), angle[rows])
            error = angle[rows] - tracked.value[:, 0]
            intervals = np.diff(t[rows], prepend=2 * t[first] - t[first + 1])
            speed[rows] = tracked.value[:, 1] + lagless(self._bandwidth, intervals) * error
            away[rows] = tracked.coasting
            self._held[name] = float(speed[rows][-1])
        return speed, away

    def _table(self, found: Columns, t: Float[np.ndarray, " N"], truth: Columns) -> Columns:
        suffixes = self.machine.suffixes()
        quantities = self.machine.quantities
        names = [name for quantity in quantities for name in quantity.columns]
        names += [f"certificate{suffix}" for suffix in suffixes]
        names += [f"coasting{suffix}" for suffix in suffixes]
        names += [f"coasting_{quantity.name}" for quantity in self._tracked]
        names += [name for name in found if name.startswith("deviation_")]
        parameters = self.machine.parameter_names()
        names += [*parameters, HELD] if parameters else []
        columns = {"t": t} | {name: found[name] for name in names}
        angles = [q.columns[0] for q in quantities if q.angle]
        for name, true in truth.items():
            error = columns[name] - true - self.offsets.get(name, 0.0)
            columns[f"error_{name}"] = _wrapped(error) if name in angles else error
        return columns

    def _residuals(self, columns: Columns, log: Log, new: int) -> Columns:
        """Those of the last `new` rows, and of the rows before that they depend on."""
        if self._before is not None:
            columns, log = _joined(*self._before, columns, log)
        if self.machine.memory:
            kept = slice(-1 - self.machine.memory, None)
            self._before = {k: x[kept] for k, x in columns.items()}, _rows(log, kept)
        found = self.machine.residuals(columns, log)
        return {name: x[x.size - new :] for name, x in found.items()}


def _joined(columns: Columns, log: Log, more: Columns, piece: Log) -> tuple[Columns, Log]:
    """Rows and those after them, of which the first is the last of the former."""
    join = lambda a, b: np.concatenate([a, b[1:]])
    truth = {k: join(x, piece.truth[k]) for k, x in log.truth.items()}
    joined = Log(join(log.t, piece.t), join(log.u, piece.u), join(log.y, piece.y), truth)
    return {k: join(x, more[k]) for k, x in columns.items()}, joined


def _rows(log: Log, rows: slice) -> Log:
    truth = {name: x[rows] for name, x in log.truth.items()}
    return Log(log.t[rows], log.u[rows], log.y[rows], truth)


def _wrapped(angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """The same angle in [-pi, pi) (rad)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def estimate_log(
    log: Log, machine: AbstractDescription, rates: Rates, substeps: int = 4
) -> Columns:
    """The table of estimates of a log in memory, by an [`Estimator`][]."""
    machine = machine.with_noise_of(log)
    substeps = 1 if is_lifted(machine.observer) else substeps
    estimator = Estimator(machine, rates, log.t, substeps)
    columns = estimator(log).columns
    if estimator.complete:
        return columns
    return Estimator(machine, rates, log.t, substeps, first=0)(log).columns
