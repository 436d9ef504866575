"""The figure of an estimate over a recorded log: what was measured, what was estimated, its
error, its certificate."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .._text import measured_unit, symbol, with_unit
from ..machines import Quantity
from . import _ticks
from ._canvas import LEFT, Canvas, grid, legend, shortened, styled
from ._lines import shade
from ._style import BLACK, TRUTH, color, style

PERIODS = 2  # shown of what turns, at the start and at the end
RPM = 60.0 / (2.0 * np.pi)  # of a rad/s
_WIDTH, _RIGHT, _HEAD = 10.0, 0.65, 0.58  # inch


def log_figure(trace: Any, summary: Any, title: str) -> Canvas:
    """What is known of a log, its rows gathered in a `trace`, its figures in a `summary`,
    from the top:

    close-ups of both ends of what turns, with what was measured and the angle; the error,
    or where there is no truth how consistent the estimate is; what does not turn, over the
    whole log; certificates.
    """
    machine, view = summary.machine, trace.whole(summary)
    turning = [q for q in machine.quantities if q.turns]
    angles = [q for q in machine.quantities if q.angle] if turning else []
    others = [q for q in machine.quantities if q not in (*turning, *angles)]
    measured = ["inputs", "outputs"]
    close = [*measured, *turning, *angles] if turning else []
    wide: list[Any] = [*([] if turning else measured), *(["error"] if view.errors else [])]
    wide += [*others, "certificate"]
    with styled():
        # Rows of one window share the labels of its time.
        windows = _windows(close, trace, summary)
        labelled = [
            w != after for w, after in zip(windows, [*windows, None][1:], strict=True)
        ]
        gaps = [0.62 if last else 0.32 for last in labelled] + [0.32] * (len(wide) - 1)
        heights = [1.15] * len(close) + [1.0] * len(wide)
        canvas = Canvas(_WIDTH, sum(heights) * 1.05 + sum(gaps) + _HEAD + 0.5)
        canvas.text(
            0.09,
            1.0 - 0.14 / canvas.get_figheight(),
            shortened(f"{machine.title}: observer over {title}", 110),
            fontsize=10,
            va="center",
        )
        panels = _Panels(trace, summary, view)
        columns = [2] * len(close) + [1] * len(wide)
        rows = grid(canvas, heights, columns, right=_RIGHT, top=_HEAD, gaps=gaps)
        for row, what, window, last in zip(rows, close, windows, labelled, strict=False):
            panels.close(row, what, window, last)
        for (axes,), what in zip(rows[len(close) :], wide, strict=True):
            panels.wide(axes, what, what == "certificate")
    return canvas


class _Panels:
    """Draws one panel after another."""

    def __init__(self, trace: Any, summary: Any, view: Any):
        self.trace, self.summary, self.view = trace, summary, view
        self.machine = summary.machine

    def close(self, row: Any, what: Any, window: float, labelled: bool) -> None:
        """Both ends of the log."""
        for axes, end in zip(row, ("start", "end"), strict=True):
            shown = self.trace.end(self.view, window, self.summary, last=end == "end")
            self._lines(axes, what, shown)
            axes.set_xlim(shown.t[0], shown.t[-1])
            _ticks.linear(axes.xaxis, "s", 6)
            axes.tick_params(labelbottom=labelled)
            if labelled:
                axes.set_xlabel("time (s)")
            if not isinstance(what, str) and end == "start":
                _shade(axes, shown, what.suffix)
            axes.set_title(
                f"{_name(what)}, start of the log" if end == "start" else "End of the log"
            )
        row[-1].set_ylabel("")  # that of its neighbour
        legend(row[-1], handlelength=1.4, columnspacing=1.0)  # beside the title

    def wide(self, axes: Any, what: Any, labelled: bool) -> None:
        """The whole log."""
        if what == "error":
            self._errors(axes)
        elif what == "certificate":
            self._certificates(axes)
        else:
            self._lines(axes, what, self.view)
            axes.set_title(_name(what))
        t = self.summary.reader.t
        axes.set_xlim(t[0], t[-1])
        _ticks.linear(axes.xaxis, "s", 10)
        axes.tick_params(labelbottom=labelled)
        if labelled:
            axes.set_xlabel("time (s)")
        # What was measured is there whether or not the estimate coasts.
        suffixes = [] if isinstance(what, str) else [what.suffix]
        if what in ("error", "certificate"):
            suffixes = self.machine.suffixes()
        for suffix in suffixes:
            _shade(axes, self.view, suffix)
        legend(axes)

    def _lines(self, axes: Any, what: Any, view: Any) -> None:
        if isinstance(what, str):
            self._measured(axes, what, view)
        elif what.angle and self.trace_turns:
            self._angle(axes, what, view)
        else:
            self._quantity(axes, what, view)

    @property
    def trace_turns(self) -> bool:
        return any(q.turns for q in self.machine.quantities)

    def _measured(self, axes: Any, kind: str, view: Any) -> None:
        columns = getattr(view, kind)
        units = {measured_unit(name) for name in columns}
        (unit,) = units if len(units) == 1 else ("",)
        for k, (name, x) in enumerate(columns.items()):
            label = symbol(name)  # the axis has the unit
            # An input is held from its instant to the next.
            held = {"drawstyle": "steps-post"} if kind == "inputs" else {}
            axes.plot(view.t, x, label=label, gid=name, lw=1.0, **style(k), **held)
        _vertical(axes, kind, unit)

    def _angle(self, axes: Any, quantity: Quantity, view: Any) -> None:
        (name,) = quantity.columns
        label = with_unit(symbol(name), "°")
        axes.plot(
            view.t, _folded(view.columns[name]), label=label, gid=name, color=color(0)
        )
        if name in view.truth:
            axes.plot(view.t, _folded(view.truth[name]), label="truth", **TRUTH)
        axes.set_ylim(-190.0, 190.0)
        _vertical(axes, quantity.name, "°")
        axes.set_yticks([-180.0, -90.0, 0.0, 90.0, 180.0])

    def _quantity(self, axes: Any, quantity: Quantity, view: Any) -> None:
        several = len(quantity.columns) > 1  # the axis has their unit
        for k, name in enumerate(quantity.columns):
            label = with_unit(symbol(name), "" if several else quantity.unit)
            axes.plot(view.t, view.columns[name], label=label, gid=name, color=color(k))
            if name in view.truth:
                last = name == quantity.columns[-1]
                axes.plot(
                    view.t, view.truth[name], label="truth" if last else None, **TRUTH
                )
        limits = self._limits(quantity)
        if limits is not None:
            axes.set_ylim(limits)
        _vertical(axes, quantity.name, quantity.unit)
        pole_pairs = getattr(self.machine.machine, "pole_pairs", None)
        if quantity.tracks is not None and pole_pairs:
            _beside(axes, RPM / pole_pairs, "mechanical (rpm)", "rpm")

    def _limits(self, quantity: Quantity) -> tuple[float, float] | None:
        """Limits that outliers do not move."""
        view, none = self.view, self.view.t[:0]
        settled = _settled(quantity, view, self.summary)
        shown = [view.columns[name][settled] for name in quantity.columns]
        shown = np.concatenate(
            [*shown, *(view.truth.get(n, none) for n in quantity.columns)]
        )
        shown = shown[np.isfinite(shown)]
        if not shown.size or not np.ptp(shown) > 0:
            return None
        size = np.ptp(shown)
        return shown.min() - 0.1 * size, shown.max() + 0.15 * size

    def _errors(self, axes: Any) -> None:
        errors = self.view.errors
        for k, (name, error) in enumerate(errors.items()):
            axes.plot(self.view.t, error, label=name, gid=name, lw=1.0, **style(k))
        vectors = any(len(q.columns) > 1 for q in self.machine.quantities)
        size = "|truth|" if vectors else "rms of the truth"
        axes.set_title(
            f"Relative error, |estimate - truth| / {size}"
            if self.view.truth
            else f"Consistency without truth, {self.machine.residual}"
        )
        shown = np.concatenate(list(errors.values()))
        shown = shown[np.isfinite(shown)]
        if shown.size:
            # At the start a flux may be near zero.
            high = min(max(shown.max(), 1e-300) * 2.0, 10.0)
            low = min(shown.min() / 2.0, high / 10.0)
            _ticks.logarithmic(axes.yaxis, "", low, high)
        axes.set_ylabel("relative (1)")

    def _certificates(self, axes: Any) -> None:
        threshold = self.machine.observer.threshold
        for k, suffix in enumerate(self.machine.suffixes()):
            name = f"certificate{suffix}"
            x = self.view.columns[name]
            axes.plot(self.view.t, x, label=symbol(name), gid=name, lw=1.0, **style(k))
        # A certificate is at most about one.
        _ticks.logarithmic(axes.yaxis, "", 1e-2 * threshold, 2.0)
        axes.axhline(threshold, label="threshold", **(BLACK | {"linewidth": 0.8}))
        axes.set(title="Certificate; grey: coasting", ylabel="certificate (1)")


def _windows(close: list[Any], trace: Any, summary: Any) -> list[float]:
    """How long (s) each close-up is: so many periods of what turns in full rows, of the
    first that does for what is not estimated."""
    turning = [what for what in close if not isinstance(what, str) and what.turns]
    if not turning:
        return []
    view = trace.tail(summary)
    found = {q.name: _window(q, view, summary) for q in turning}
    first = found[turning[0].name]
    return [first if isinstance(q, str) else found.get(q.name, first) for q in close]


def _window(quantity: Quantity, view: Any, summary: Any) -> float:
    t, log = view.t, summary.reader.t
    first, second = (view.columns[name] for name in quantity.columns)
    turned = np.abs(np.diff(np.unwrap(np.arctan2(second, first))))
    settled = _settled(quantity, view, summary)[1:]
    speed = float(np.median((turned / np.diff(t))[settled])) if settled.any() else 0.0
    window = PERIODS * 2.0 * np.pi / speed if speed > 0 else np.inf
    return float(min(window, log[-1] - log[0]))


def _settled(quantity: Quantity, view: Any, summary: Any) -> Bool[np.ndarray, " N"]:
    return view.t >= summary.settled.get(quantity.suffix, np.inf)


def _name(what: Any) -> str:
    return (what if isinstance(what, str) else what.name).capitalize()


def _vertical(axes: Any, label: str, unit: str) -> None:
    axes.set_ylabel(with_unit(label, unit))
    _ticks.linear(axes.yaxis, unit, 4)


def _beside(axes: Any, factor: float, label: str, unit: str) -> None:
    """The same axis in another unit, at the right."""
    low, high = axes.get_ylim()
    other = axes.twinx()
    other.grid(visible=False)
    other.set(ylim=(factor * low, factor * high), ylabel=label)
    other.spines["right"].set_visible(True)
    other.yaxis.set_label_coords(1.0 + 0.48 / (_WIDTH - LEFT - _RIGHT), 0.5)
    _ticks.linear(other.yaxis, unit, 4)


def _folded(angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """An angle (rad) in degrees from -180 to 180, with gaps where it leaps."""
    folded = np.degrees((angle + np.pi) % (2.0 * np.pi) - np.pi)
    leaps = np.flatnonzero(np.abs(np.diff(folded)) > 180.0) + 1
    folded[leaps] = np.nan
    return folded


def _shade(axes: Any, view: Any, suffix: str) -> None:
    """Shade the intervals in which an estimate coasts."""
    shade(axes, view.t, view.columns[f"coasting{suffix}"].astype(bool))
