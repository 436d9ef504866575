"""The figures of a report."""

import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from .._extras import require
from .bands import Band
from .formats import number
from .tables import Table

# Okabe and Ito's palette, which survives colour blindness, and two greys.
COLORS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F3C8D", "#666666",
)  # fmt: skip
_SETTINGS: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "svg.hashsalt": "aslo_jax",
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
}
_TALL = 20.0  # beyond this ratio an axis is logarithmic
_WIDTH = 7.2  # inch: the text width of a page of A4


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure of a report: the `name` of its file, a `caption`, and `draw(canvas)`, which
    draws on an empty `matplotlib.figure.Figure` of a `height` (inch)."""

    name: str
    caption: str
    draw: Callable[[Any], None]
    height: float

    def render(self) -> dict[str, bytes]:
        """The figure as `"png"` and as `"svg"`, without a display; the same figure, the
        same bytes. It is drawn and laid out once for both, which takes the longest."""
        require("matplotlib", "plot")
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        found = {}
        with matplotlib.rc_context(_SETTINGS):
            canvas = Canvas(figsize=(_WIDTH, self.height), dpi=150)
            FigureCanvasAgg(canvas)
            self.draw(canvas)
            # Once, here: with an engine of its own a figure is drawn twice to be saved.
            ConstrainedLayoutEngine().execute(canvas)
            for kind, dated in (("png", "Software"), ("svg", "Date")):
                out = io.BytesIO()
                canvas.savefig(out, dpi="figure", format=kind, metadata={dated: None})
                found[kind] = out.getvalue()
        return found


def metric_figure(tables: Sequence[Table]) -> Figure:
    """Every metric, observer by observer."""
    observers = list(tables[0].summaries)
    columns = 1 if len(tables) == 1 else 2
    rows = -(-len(tables) // columns)

    def draw(canvas):
        grid = canvas.subplots(rows, columns, squeeze=False).ravel()
        for axes, table in zip(grid, tables, strict=False):
            _metric(axes, table)
        for axes in grid[len(tables) :]:
            axes.set_axis_off()

    caption = (
        "Each metric over the samples. Dot: median; bar: 5 to 95 %; tick: worst sample; "
        "arrow: infinite, since samples diverged or never settled."
    )
    if any(table.bound is not None for table in tables):
        caption += (
            " Dashed: Cramér-Rao bound on the rms over samples, which is the diamond."
        )
    return Figure("metrics", caption, draw, rows * (0.9 + 0.24 * len(observers)))


def band_figure(
    time: Float[np.ndarray, " T"],
    bands: Mapping[str, Band],
    unit: str,
    bound: Float[np.ndarray, " T"] | None,
) -> Figure:
    """The error over `time` (s), one panel per observer on common axes."""
    columns = min(3, len(bands))
    rows = -(-len(bands) // columns)

    def draw(canvas):
        grid = canvas.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        panels = grid.ravel()
        for index, (axes, name) in enumerate(zip(panels, bands, strict=False)):
            color, band = COLORS[index % len(COLORS)], bands[name]
            for other in bands.values():
                axes.plot(time, _shown(other.median), color="0.75", linewidth=0.7)
            axes.fill_between(
                time, _shown(band.low), _shown(band.high), color=color, alpha=0.25, lw=0
            )
            axes.plot(time, _shown(band.worst), color=color, linewidth=0.7)
            axes.plot(time, _shown(band.median), color=color)
            if bound is not None:
                axes.plot(time, bound, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
            axes.set_title(name)
        for axes in panels[len(bands) :]:
            axes.set_axis_off()
            # The panel above has no neighbour below that would carry its labels.
        for index, axes in enumerate(panels[: len(bands)]):
            if index + columns >= len(bands):
                axes.tick_params(labelbottom=True)
                axes.set_xlabel("time (s)")
        for axes in grid[:, 0]:
            axes.set_ylabel(_named("error", unit))
        _scale(panels[0], "y", [x for band in bands.values() for x in band[:3]])

    dashed = "" if bound is None else " Dashed: Cramér-Rao bound on the rms over samples."
    caption = (
        "The norm of the estimation error over time. Thick line: median over the samples; "
        "band: 5 to 95 %; thin line: worst sample, where it is finite; grey: the medians "
        f"of the other observers.{dashed}"
    )
    return Figure("error", caption, draw, 0.5 + 1.9 * rows)


def parameter_figure(parameters: Mapping[str, Float[np.ndarray, " N"]]) -> Figure:
    """How the spread parameters are distributed; values by label with unit."""
    columns = min(4, max(2, len(parameters)))
    rows = -(-len(parameters) // columns)

    def draw(canvas):
        panels = canvas.subplots(rows, columns, squeeze=False).ravel()
        for axes, (label, values) in zip(panels, parameters.items(), strict=False):
            _histogram(axes, values)
            axes.set_xlabel(label)
        for axes in panels[::columns]:
            axes.set_ylabel("samples")
        for axes in panels[len(parameters) :]:
            axes.set_axis_off()

    caption = "How the spread parameters are distributed over the samples."
    return Figure("parameters", caption, draw, 0.2 + 1.55 * rows)


def _metric(axes, table):
    observers = list(table.summaries)
    drawn = [
        s for t in table.summaries.values() for s in (t.low.value, t.rms.value, t.worst)
    ]
    _scale(axes, "x", [np.array([*drawn, *([] if table.bound is None else [table.bound])])])
    finite = np.array([x for x in drawn if np.isfinite(x)] or [1.0])
    left = finite[finite > 0].min(initial=finite.max()) if (finite > 0).any() else 0.0
    right = finite.max() or 1.0
    log = axes.get_xscale() == "log"
    edge = right * (right / left) ** 0.08 if log else right * 1.05
    for row, name in enumerate(observers):
        found, color = table.summaries[name], COLORS[row % len(COLORS)]
        y = len(observers) - 1 - row

        def at(x):
            return min(max(x, left), edge) if log else min(x, edge)

        axes.plot([at(found.low.value), at(found.high.value)], [y, y], color=color, lw=3.0,
                  alpha=0.45, solid_capstyle="butt")  # fmt: skip
        axes.plot(at(found.median.value), y, "o", color=color, markersize=4.5)
        worst = ">" if np.isinf(found.worst) else "|"
        axes.plot(at(found.worst), y, worst, color=color, markersize=5.5)
        if table.bound is not None and np.isfinite(found.rms.value):
            axes.plot(found.rms.value, y, "D", color=color, markersize=3.5,
                      markerfacecolor="white")  # fmt: skip
    if table.bound is not None:
        axes.axvline(table.bound, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
    axes.set_yticks(range(len(observers)), observers[::-1])
    axes.set_ylim(-0.6, len(observers) - 0.4)
    axes.grid(False, axis="y")
    axes.set_xlabel(_named(table.label, table.unit))
    if not log:
        axes.set_xlim(left=0.0)


def _histogram(axes, values) -> None:
    distinct = np.unique(values[:10_000])
    if distinct.size <= 12:
        counts = [(values == x).sum() for x in distinct]
        width = 0.6 * (np.diff(distinct).min() if distinct.size > 1 else 1.0)
        axes.bar(distinct, counts, width=width, color="0.55")
        axes.set_xticks(distinct)
    else:
        finite = values[np.isfinite(values)]
        counts, edges = np.histogram(finite, bins=min(40, 5 + int(np.sqrt(finite.size))))
        axes.stairs(counts, edges, fill=True, color="0.55")
    axes.locator_params(axis="y", nbins=4)
    axes.grid(False, axis="x")
    if distinct.size > 12:
        axes.locator_params(axis="x", nbins=4)


def _scale(axes, which, series) -> None:
    """A logarithmic axis where what is drawn spans decades, from what is positive."""
    x = np.concatenate([np.ravel(s) for s in series])
    positive = x[np.isfinite(x) & (x > 0)]
    if positive.size == 0 or positive.size < 0.9 * np.isfinite(x).sum():
        return
    # Round zeros at single instants do not stretch the axis over twenty decades.
    least = max(positive.min(), np.quantile(positive, 0.01) / 10.0)
    if positive.max() > _TALL * least:
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        if which == "y":
            axes.set_ylim(bottom=least / 1.5)
        _label_decades(axes.xaxis if which == "x" else axes.yaxis, positive.max() / least)


def _label_decades(axis, ratio) -> None:
    """Labels that do not run into each other, however few decades there are."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_minor_formatter(NullFormatter())
    if ratio < 1e3:
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.set_major_formatter(FuncFormatter(lambda x, _: number(x, 1)))


def _shown(x):
    return np.where(np.isfinite(x), x, np.nan)


def _named(label, unit):
    return f"{label} ({unit})" if unit else label
