"""The figure of an estimate: what was estimated, its error, its certificate."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .._extras import require
from ..logs import Log
from ..machines import AbstractDescription, Quantity
from . import table

SUFFIXES = (".png", ".pdf", ".svg")
PERIODS = 2  # shown of what turns, at the start and at the end

COLORS = ("C3", "C2", "C4", "C5", "C6", "C8")  # of what is trusted apart
TRUTH: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 0.9}


def check_figure_suffix(path: Path) -> None:
    """Refuse a figure whose suffix is not that of a known format."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{path} has the suffix {path.suffix!r}, but a figure is one of "
            f"{', '.join(SUFFIXES)}."
        )


def save_figure(
    path: Path,
    result: table.Result,
    log: Log,
    machine: AbstractDescription,
    title: str,
) -> None:
    """Draw `result` and write it to `path`, in the format of its suffix.

    From the top: close-ups of what turns; its error, or where there is no truth how
    consistent it is; what does not turn, over the whole log; certificates."""
    figures = require("matplotlib.figure", "cli,plot")
    turning = [q for q in machine.quantities if q.turns]
    others = [q for q in machine.quantities if not (q.turns or q.angle)]
    errors = _errors(result, log, machine)
    wide = [*(["error"] if errors else []), *(q.name for q in others), "certificate"]
    closeups = [[f"{q.name} {end}" for end in ("start", "end")] for q in turning]
    figure = figures.Figure(figsize=(10, 2 * len(wide) + 2.6 * len(turning) + 1))
    figure.set_layout_engine("constrained")
    axes = figure.subplot_mosaic(
        [*closeups, *([name, name] for name in wide)],
        height_ratios=[1.3] * len(turning) + [1.0] * len(wide),
    )
    figure.suptitle(f"{machine.title}: observer over {title}")
    for quantity, (start, end) in zip(turning, closeups, strict=True):
        _draw_closeups(axes[start], axes[end], quantity, result)
    if errors:
        _draw_errors(axes["error"], errors, log, machine, bool(result.truth))
    for quantity in others:
        axis = axes[quantity.name]
        _draw(axis, quantity, result, np.ones(log.t.size, bool))
        axis.set_title(quantity.name.capitalize())
        axis.legend(loc="upper right", ncols=3)
    _draw_certificates(axes["certificate"], result, machine)
    for name in wide:
        axes[name].set_xlim(log.t[0], log.t[-1])
        axes[name].sharex(axes["certificate"])
        for suffix in machine.suffixes():
            _shade(axes[name], result, suffix)
    for axis in axes.values():
        axis.grid(alpha=0.3)
    axes["certificate"].set_xlabel("time (s)")
    # The Agg, PDF or SVG canvas is chosen by the suffix; no window is opened.
    figure.savefig(path, dpi=130)


def _draw(
    axis: Any, quantity: Quantity, result: table.Result, rows: Bool[np.ndarray, " N"]
) -> None:
    """The columns of a quantity, with their truth; limits that outliers do not move."""
    t, values = result.columns["t"], [result.columns[name] for name in quantity.columns]
    for k, (name, value) in enumerate(zip(quantity.columns, values, strict=True)):
        axis.plot(t[rows], value[rows], color=f"C{k}", label=name)
        if name in result.truth:
            last = name == quantity.columns[-1]
            label = "truth" if last else None
            axis.plot(t[rows], result.truth[name][rows], label=label, **TRUTH)
    settled = result.settled(quantity.suffix)
    shown = np.concatenate([value[settled] for value in values])
    shown = np.concatenate([shown, *(result.truth.get(n, t[:0]) for n in quantity.columns)])
    if shown.size and np.ptp(shown) > 0:
        size = np.ptp(shown)
        axis.set_ylim(shown.min() - 0.1 * size, shown.max() + 0.3 * size)  # and a legend
    axis.set(ylabel=f"{quantity.unit}", xlim=(t[rows][0], t[rows][-1]))


def _draw_closeups(start: Any, end: Any, quantity: Quantity, result: table.Result) -> None:
    t = result.columns["t"]
    first, second = (result.columns[name] for name in quantity.columns)
    turned = np.abs(np.diff(np.unwrap(np.arctan2(second, first))))
    settled = result.settled(quantity.suffix)[1:]
    speed = float(np.median((turned / np.diff(t))[settled])) if settled.any() else 0.0
    window = PERIODS * 2.0 * np.pi / speed if speed > 0 else np.inf
    window = min(window, t[-1] - t[0])
    for axis, when, rows in (
        (start, "start", t <= t[0] + window),
        (end, "end", t >= t[-1] - window),
    ):
        _draw(axis, quantity, result, rows)
        axis.set(
            xlabel="time (s)", title=f"{quantity.name.capitalize()}, {when} of the log"
        )
    _shade(start, result, quantity.suffix)
    end.legend(loc="upper right", ncols=3)


def _errors(
    result: table.Result, log: Log, machine: AbstractDescription
) -> dict[str, Float[np.ndarray, " N"]]:
    """By quantity, relative: to the truth, of vectors where there are any, or of the
    equation that ought to hold."""
    if not result.truth:
        return machine.residuals(result.columns, log)
    scored = _vectors(machine) or machine.quantities
    errors = {quantity.name: result.relative_error(quantity) for quantity in scored}
    return {name: error for name, error in errors.items() if error is not None}


def _vectors(machine: AbstractDescription) -> list[Quantity]:
    return [quantity for quantity in machine.quantities if len(quantity.columns) > 1]


def _draw_errors(
    axis: Any,
    errors: dict[str, Float[np.ndarray, " N"]],
    log: Log,
    machine: AbstractDescription,
    truth: bool,
) -> None:
    for k, (name, error) in enumerate(errors.items()):
        color, value = COLORS[k % len(COLORS)], _above_zero(error)
        axis.semilogy(log.t, value, color=color, linewidth=1, label=name)
    size = "|truth|" if _vectors(machine) else "rms of the truth"
    axis.set_title(
        f"Relative error, |estimate - truth| / {size}"
        if truth
        else f"Consistency without truth, {machine.residual}"
    )
    axis.set_ylabel("1")
    low, high = axis.get_ylim()
    if low < 10.0 < high:  # at the start a flux may be near zero
        axis.set_ylim(top=10.0)
    axis.legend(loc="upper right", ncols=3)


def _draw_certificates(
    axis: Any, result: table.Result, machine: AbstractDescription
) -> None:
    threshold = machine.observer.threshold
    axis.set_ylim(1e-2 * threshold, 2.0)  # a certificate is at most about one
    for k, suffix in enumerate(machine.suffixes()):
        name = f"certificate{suffix}"
        value = _above_zero(result.columns[name])
        axis.semilogy(
            result.columns["t"],
            value,
            color=COLORS[k % len(COLORS)],
            linewidth=1,
            label=name,
        )
    axis.axhline(threshold, color="black", linestyle=":", label="threshold")
    axis.legend(loc="lower right", ncols=3)
    axis.set(ylabel="1", title="Certificate; grey: coasting")


def _above_zero(x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """`x` with gaps where it is not positive or not finite, for a logarithmic axis."""
    return np.where((x > 0) & np.isfinite(x), x, np.nan)


def _shade(axis: Any, result: table.Result, suffix: str) -> None:
    """Shade the intervals in which an estimate coasts."""
    t, coasting = result.columns["t"], result.columns[f"coasting{suffix}"].astype(bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], coasting, [False]])))
    for first, after in edges.reshape(-1, 2):
        until = t[min(after, t.size - 1)]
        axis.axvspan(t[first], until, color="black", alpha=0.15, linewidth=0)
