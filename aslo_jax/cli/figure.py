"""The figure of an estimate: flux, its error, speed, certificate."""

from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ..logs import Log
from ..machine import Machine
from . import flux

SUFFIXES = (".png", ".pdf", ".svg")
PERIODS = 2  # electrical periods shown of the flux, at the start and at the end

ESTIMATE = ("C0", "C1")  # of the alpha and the beta component
TRUTH: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 0.9}


def check_figure_suffix(path: Path) -> None:
    """Refuse a figure whose suffix is not that of a known format."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{path} has the suffix {path.suffix!r}, but a figure is one of "
            f"{', '.join(SUFFIXES)}."
        )


def save_figure(
    path: Path, result: flux.Result, log: Log, machine: Machine, title: str
) -> None:
    """Draw `result` and write it to `path`, in the format of its suffix."""
    figures = require("matplotlib.figure", "cli,plot")
    figure = figures.Figure(figsize=(10.0, 10.0), layout="constrained")
    axes = figure.subplot_mosaic(
        [["start", "end"], ["error", "error"], ["speed", "speed"], ["trust", "trust"]],
        height_ratios=[1.3, 1.0, 1.0, 1.0],
    )
    figure.suptitle(f"Flux observer over {title}")
    _draw_flux(axes["start"], axes["end"], result, log)
    _draw_error(axes["error"], result, log, machine)
    _draw_speed(axes["speed"], result, log, machine.machine.pole_pairs)
    _draw_certificate(axes["trust"], result)
    wide = [axes[name] for name in ("error", "speed", "trust")]
    for axis in wide:
        axis.set_xlim(log.t[0], log.t[-1])
        axis.sharex(wide[-1])
        _shade(axis, result)
    for axis in axes.values():
        axis.grid(alpha=0.3)
    wide[-1].set_xlabel("time (s)")
    # The Agg, PDF or SVG canvas is chosen by the suffix; no window is opened.
    figure.savefig(path, dpi=130)


def _draw_flux(start: Any, end: Any, result: flux.Result, log: Log) -> None:
    t, columns = log.t, result.columns
    speed = float(np.median(np.abs(columns["omega_electrical"])))
    window = PERIODS * 2.0 * np.pi / speed if speed > 0 else np.inf
    window = min(window, t[-1] - t[0])
    limit = 1.6 * np.quantile(np.hypot(columns["flux_alpha"], columns["flux_beta"]), 0.9)
    for axis, rows in ((start, t <= t[0] + window), (end, t >= t[-1] - window)):
        for name, label, color in zip(
            ("flux_alpha", "flux_beta"), ("alpha", "beta"), ESTIMATE, strict=True
        ):
            axis.plot(t[rows], columns[name][rows], color=color, label=label)
            if name in log.truth:
                only_once = "truth" if label == "beta" else None
                axis.plot(t[rows], log.truth[name][rows], label=only_once, **TRUTH)
        axis.set(xlabel="time (s)", ylabel="flux (Wb)", xlim=(t[rows][0], t[rows][-1]))
        if limit > 0:
            axis.set_ylim(-limit, limit)
    _shade(start, result)
    start.set_title("Stator flux, start of the log")
    end.set_title("Stator flux, end of the log")
    end.legend(loc="upper right", ncols=3)


def _draw_error(axis: Any, result: flux.Result, log: Log, machine: Machine) -> None:
    relative = flux.relative_flux_error(result, log)
    if relative is not None:
        axis.set_title("Relative flux error, |flux - truth| / |truth|")
    else:
        motor, columns = machine.machine, result.columns
        rotor = np.hypot(
            columns["flux_alpha"] - motor.inductance * log.y[:, 0],
            columns["flux_beta"] - motor.inductance * log.y[:, 1],
        )
        relative = np.abs(rotor / motor.magnet_flux - 1.0)
        axis.set_title("Consistency without truth, | |flux - L i| / magnet flux - 1 |")
    axis.semilogy(log.t, _above_zero(relative), color="C3", linewidth=1.0)
    axis.set_ylabel("relative (1)")


def _draw_speed(axis: Any, result: flux.Result, log: Log, pole_pairs: int) -> None:
    speed = result.columns["omega_electrical"]
    axis.plot(log.t, speed, color="C0", label="estimate")
    if "omega_mechanical" in log.truth:
        axis.plot(log.t, pole_pairs * log.truth["omega_mechanical"], label="truth", **TRUTH)
        axis.legend(loc="upper right", ncols=2)
    axis.set(ylabel="speed (rad/s)", title="Electrical speed, phase-locked loop")


def _draw_certificate(axis: Any, result: flux.Result) -> None:
    t, certificate = result.columns["t"], _above_zero(result.columns["certificate"])
    axis.semilogy(t, certificate, color="C2", linewidth=1.0)
    axis.axhline(result.settings.threshold, color="black", linestyle=":", label="threshold")
    axis.legend(loc="lower right")
    axis.set(ylabel="certificate (1)", title="Certificate; grey: coasting")
    axis.set_ylim(bottom=1e-2 * result.settings.threshold)


def _above_zero(x: np.ndarray) -> np.ndarray:
    """`x` with gaps where it is not positive, for a logarithmic axis."""
    return np.where(x > 0, x, np.nan)


def _shade(axis: Any, result: flux.Result) -> None:
    """Shade the intervals in which the estimate coasts."""
    t, coasting = result.columns["t"], result.columns["coasting"].astype(bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], coasting, [False]])))
    for first, after in edges.reshape(-1, 2):
        until = t[min(after, t.size - 1)]
        axis.axvspan(t[first], until, color="black", alpha=0.15, linewidth=0)
