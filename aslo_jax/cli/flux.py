"""From a log and an observer to the table of estimates."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ..logs import Log
from ..machine import Machine, cutoff_for, electrical_speed
from ..observers import AbstractObserver, Estimate, PhaseLockedLoop
from ..replay import replay

PIECE = 50_000  # rows replayed at once


@dataclasses.dataclass(frozen=True)
class Settings:
    """What was used, given or chosen.

    - `cutoff`, `pll_bandwidth` (rad/s); `threshold` of the certificate;
    - `speed`: the electrical speed that the cutoff was chosen for (rad/s), if it was;
    - `substeps` per sampling interval.
    """

    cutoff: float
    pll_bandwidth: float
    threshold: float
    speed: float | None
    substeps: int


@dataclasses.dataclass(frozen=True)
class Result:
    """The estimates of a log of `N` rows.

    - `columns`: the table, each column of shape `(N,)`;
    - `settings`: what was used;
    - `start`: the row of the first certified estimate, `None` where there is none.
    """

    columns: dict[str, np.ndarray]
    settings: Settings
    start: int | None


def choose(
    log: Log,
    machine: Machine,
    cutoff: float | None = None,
    pll_bandwidth: float | None = None,
    substeps: int = 4,
) -> Settings:
    """The settings for a log: those given, then those of the machine, then defaults.

    `cutoff` and `pll_bandwidth` are in rad/s. The loop is sampled by Heun's method, which
    wants its bandwidth below half of the sampling rate: the default gives way to that, a
    bandwidth that was given is refused."""
    settings, speed = machine.observer, None
    cutoff = settings.cutoff if cutoff is None else cutoff
    if cutoff is None:
        speed = electrical_speed(log.t, log.u, log.y, machine.machine.resistance)
        cutoff = cutoff_for(speed)
    fastest = 0.5 / float(np.median(np.diff(log.t)))
    given = pll_bandwidth is not None or "pll_bandwidth" in settings.model_fields_set
    bandwidth = settings.pll_bandwidth if pll_bandwidth is None else pll_bandwidth
    if given and bandwidth > fastest:
        raise ValueError(
            f"the bandwidth of the phase-locked loop must be at most {fastest:.4g} rad/s "
            f"for the sampling interval of this log, but is {bandwidth:.4g}; lower "
            "--pll-bandwidth or `observer.pll_bandwidth`."
        )
    bandwidth = min(bandwidth, fastest)
    return Settings(cutoff, bandwidth, settings.threshold, speed, substeps)


def estimate_flux(
    log: Log,
    machine: Machine,
    settings: Settings,
    progress: Callable[[int], Any] = lambda rows: None,
) -> Result:
    """Run the flux observer and a phase-locked loop over a log.

    The columns are `t` (s), `flux_alpha`, `flux_beta` (Wb), `theta_electrical` (rad, the
    angle of `flux - L i`, unwrapped along the log), `omega_electrical` (rad/s, of the
    phase-locked loop), `certificate`, `coasting` (0 or 1) and, where the log has truth,
    the errors, estimate less truth. `progress` is told of rows as they are done.

    The speed is `w + 2 b e` of the loop's state w and angle error e: unlike w alone, it
    does not lag under constant acceleration. It is zero before the first certified
    estimate, where the loop starts.
    """
    observer = machine.flux_observer(settings.cutoff)
    estimate = in_pieces(observer, log.t, log.u, log.y, settings.substeps, progress)
    coasting = np.asarray(estimate.coasting)
    start = None if coasting.all() else int(np.argmin(coasting))
    rotor = np.asarray(estimate.value) - machine.machine.inductance * log.y
    angle = np.unwrap(np.arctan2(rotor[:, 1], rotor[:, 0]))
    columns = {
        "t": log.t,
        "flux_alpha": np.asarray(estimate.value)[:, 0],
        "flux_beta": np.asarray(estimate.value)[:, 1],
        "theta_electrical": angle,
        "omega_electrical": _speed(log.t, angle, start, settings.pll_bandwidth),
        "certificate": np.asarray(estimate.certificate),
        "coasting": coasting.astype(np.uint8),
    }
    columns |= _errors(columns, log, machine.machine.pole_pairs)
    return Result(columns, settings, start)


def in_pieces(
    observer: AbstractObserver,
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N ..."],
    y: Float[np.ndarray, "N ..."],
    substeps: int = 1,
    progress: Callable[[int], Any] = lambda rows: None,
) -> Estimate:
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
    start: int | None,
    bandwidth: float,
) -> Float[np.ndarray, " N"]:
    """The electrical speed (rad/s) from an angle (rad) that counts from row `start`."""
    speed, first = np.zeros_like(t), start or 0
    if t.size - first < 2:
        return speed
    t, angle = t[first:], angle[first:]
    loop = in_pieces(PhaseLockedLoop(bandwidth), t, np.zeros_like(t), angle)
    error = _wrap(angle - loop.value[:, 0])
    speed[first:] = loop.value[:, 1] + 2.0 * bandwidth * error
    return speed


def _wrap(angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """The same angle in [-pi, pi) (rad)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _errors(
    columns: dict[str, np.ndarray], log: Log, pole_pairs: int
) -> dict[str, np.ndarray]:
    truth = dict(log.truth)
    if "omega_mechanical" in truth:
        truth["omega_electrical"] = pole_pairs * truth.pop("omega_mechanical")
    errors = {f"error_{name}": columns[name] - value for name, value in truth.items()}
    if "error_theta_electrical" in errors:
        errors["error_theta_electrical"] = _wrap(errors["error_theta_electrical"])
    return errors


def relative_flux_error(result: Result, log: Log) -> Float[np.ndarray, " N"] | None:
    """`|flux error| / |true flux|` row by row, where the log has both true components."""
    if not {"flux_alpha", "flux_beta"} <= log.truth.keys():
        return None
    size = np.hypot(log.truth["flux_alpha"], log.truth["flux_beta"])
    error = np.hypot(result.columns["error_flux_alpha"], result.columns["error_flux_beta"])
    return error / np.maximum(size, np.finfo(float).tiny)


def settled(result: Result) -> Bool[np.ndarray, " N"]:
    """The rows that a summary counts: from ten time constants of the loop (0.1 s by
    default) after the first certified estimate on, or from that one in a short log."""
    t = result.columns["t"]
    if result.start is None:
        return np.zeros(t.size, bool)
    rows = t >= t[result.start] + 10.0 / result.settings.pll_bandwidth
    return rows if rows.any() else t >= t[result.start]
