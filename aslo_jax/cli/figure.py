"""The figure of an estimate: what was estimated, its error, its certificate."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from .._extras import require
from ..machines import AbstractDescription, Quantity
from .summary import Summary
from .trace import Trace, View, vectors

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


def save_figure(path: Path, trace: Trace, summary: Summary, title: str) -> None:
    """Draw what was estimated and write it to `path`, in the format of its suffix.

    From the top: close-ups of what turns; its error, or where there is no truth how
    consistent it is; what does not turn, over the whole log; certificates."""
    figures = require("matplotlib.figure", "cli,plot")
    layouts = require("matplotlib.layout_engine", "cli,plot")
    machine, view = summary.machine, trace.whole(summary)
    turning = [q for q in machine.quantities if q.turns]
    others = [q for q in machine.quantities if not (q.turns or q.angle)]
    wide = [
        *(["error"] if view.errors else []),
        *(q.name for q in others),
        "certificate",
    ]
    closeups = [[f"{q.name} {end}" for end in ("start", "end")] for q in turning]
    figure = figures.Figure((10, 2 * len(wide) + 2.6 * len(turning) + 1), dpi=130)
    axes = figure.subplot_mosaic(
        [*closeups, *([name, name] for name in wide)],
        height_ratios=[1.3] * len(turning) + [1.0] * len(wide),
    )
    figure.suptitle(f"{machine.title}: observer over {title}")
    for quantity, (start, end) in zip(turning, closeups, strict=True):
        _draw_closeups(axes[start], axes[end], quantity, view, trace, summary)
    if view.errors:
        _draw_errors(axes["error"], view, machine)
    for quantity in others:
        axis = axes[quantity.name]
        _draw(axis, quantity, view, _limits(quantity, view, summary))
        axis.set_title(quantity.name.capitalize())
        axis.legend(loc="upper right", ncols=3)
    _draw_certificates(axes["certificate"], view, machine)
    for name in wide:
        axes[name].set_xlim(summary.reader.t[0], summary.reader.t[-1])
        axes[name].sharex(axes["certificate"])
        for suffix in machine.suffixes():
            _shade(axes[name], view, suffix)
    for axis in axes.values():
        axis.grid(alpha=0.3)
    axes["certificate"].set_xlabel("time (s)")
    # Once, here: with an engine of its own a figure is drawn twice to be saved.
    layouts.ConstrainedLayoutEngine().execute(figure)
    # The Agg, PDF or SVG canvas is chosen by the suffix; no window is opened.
    figure.savefig(path, dpi="figure")


def _draw(
    axis: Any, quantity: Quantity, view: View, limits: tuple[float, float] | None
) -> None:
    """The columns of a quantity, with their truth."""
    for k, name in enumerate(quantity.columns):
        axis.plot(view.t, view.columns[name], color=f"C{k}", label=name)
        if name in view.truth:
            last = name == quantity.columns[-1]
            label = "truth" if last else None
            axis.plot(view.t, view.truth[name], label=label, **TRUTH)
    if limits is not None:
        axis.set_ylim(limits)
    axis.set(ylabel=f"{quantity.unit}", xlim=(view.t[0], view.t[-1]))


def _limits(quantity: Quantity, view: View, summary: Summary) -> tuple[float, float] | None:
    """Limits that outliers do not move."""
    settled = _settled(quantity, view, summary)
    shown = np.concatenate([view.columns[name][settled] for name in quantity.columns])
    none = view.t[:0]
    shown = np.concatenate([shown, *(view.truth.get(n, none) for n in quantity.columns)])
    if not shown.size or not np.ptp(shown) > 0:
        return None
    size = np.ptp(shown)
    return shown.min() - 0.1 * size, shown.max() + 0.3 * size  # and a legend


def _settled(quantity: Quantity, view: View, summary: Summary) -> Bool[np.ndarray, " N"]:
    return view.t >= summary.settled.get(quantity.suffix, np.inf)


def _draw_closeups(
    start: Any, end: Any, quantity: Quantity, view: View, trace: Trace, summary: Summary
) -> None:
    limits = _limits(quantity, view, summary)
    window = _window(quantity, trace.tail(summary), summary)
    for axis, when in ((start, "start"), (end, "end")):
        shown = trace.end(view, window, summary, last=when == "end")
        _draw(axis, quantity, shown, limits)
        if when == "start":
            _shade(axis, shown, quantity.suffix)
        axis.set(
            xlabel="time (s)", title=f"{quantity.name.capitalize()}, {when} of the log"
        )
    end.legend(loc="upper right", ncols=3)


def _window(quantity: Quantity, view: View, summary: Summary) -> float:
    """How long (s) a close-up is: so many periods of what turns in full rows."""
    t, log = view.t, summary.reader.t
    first, second = (view.columns[name] for name in quantity.columns)
    turned = np.abs(np.diff(np.unwrap(np.arctan2(second, first))))
    settled = _settled(quantity, view, summary)[1:]
    speed = float(np.median((turned / np.diff(t))[settled])) if settled.any() else 0.0
    window = PERIODS * 2.0 * np.pi / speed if speed > 0 else np.inf
    return min(window, log[-1] - log[0])


def _draw_errors(axis: Any, view: View, machine: AbstractDescription) -> None:
    for k, (name, error) in enumerate(view.errors.items()):
        color = COLORS[k % len(COLORS)]
        axis.semilogy(view.t, error, color=color, linewidth=1, label=name)
    size = "|truth|" if vectors(machine) else "rms of the truth"
    axis.set_title(
        f"Relative error, |estimate - truth| / {size}"
        if view.truth
        else f"Consistency without truth, {machine.residual}"
    )
    axis.set_ylabel("1")
    low, high = axis.get_ylim()
    if low < 10.0 < high:  # at the start a flux may be near zero
        axis.set_ylim(top=10.0)
    axis.legend(loc="upper right", ncols=3)


def _draw_certificates(axis: Any, view: View, machine: AbstractDescription) -> None:
    threshold = machine.observer.threshold
    axis.set_ylim(1e-2 * threshold, 2.0)  # a certificate is at most about one
    for k, suffix in enumerate(machine.suffixes()):
        name, color = f"certificate{suffix}", COLORS[k % len(COLORS)]
        axis.semilogy(view.t, view.columns[name], color=color, linewidth=1, label=name)
    axis.axhline(threshold, color="black", linestyle=":", label="threshold")
    axis.legend(loc="lower right", ncols=3)
    axis.set(ylabel="1", title="Certificate; grey: coasting")


def _shade(axis: Any, view: View, suffix: str) -> None:
    """Shade the intervals in which an estimate coasts."""
    t, coasting = view.t, view.columns[f"coasting{suffix}"].astype(bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], coasting, [False]])))
    for first, after in edges.reshape(-1, 2):
        until = t[min(after, t.size - 1)]
        axis.axvspan(t[first], until, color="black", alpha=0.15, linewidth=0)
