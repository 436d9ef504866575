"""Studies: bands of the error, rankings of the observers."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.typing import ArrayLike

from .._text import with_unit
from . import _ticks
from ._canvas import drawing, shortened, width_of
from ._figure import WIDTH
from ._style import BLACK, SETTINGS, color

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..study._bands import Band
    from ..study._tables import Table

_TALL = 20.0  # beyond this ratio an axis is logarithmic
_DASHED = BLACK | {"linewidth": 1.0}


def bands(
    study: Any,
    t: ArrayLike | None = None,
    *,
    unit: str = "",
    bound: ArrayLike | None = None,
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw the error of a study over time, one panel for each observer: the median over the
    samples, the band from 5 to 95 %, the worst sample where it is finite, and in grey the
    medians of the other observers.

    **Arguments:**

    - `study`: the `xarray.Dataset` of [`aslo_jax.study.run`][], with its trajectories
      (`error` over `sample`, `time` and `observer`), or bands by observer, each an object
      with `low`, `median`, `high` and `worst`, shape `(T,)`;
    - `t`: the instants (s), shape `(T,)`, of bands alone; a dataset knows its own, its
      `unit` of the error and the Cramer-Rao `bound` on the rms over samples, shape `(T,)`;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: one of its axes
      for each observer; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for a study without trajectories, for shapes or axes that do
    not fit; `ImportError` naming the command that installs matplotlib.
    """
    found, time, unit, bound = _bands(study, t, unit, bound)
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    places = {"width": WIDTH, "inch": 1.35, "inner": 0.34, "gaps": 0.45}
    places |= {"count": len(found)}
    of = "one for each observer"
    if axes is not None:
        rows, columns = len(found), 1
    with drawing(figure, axes, [1.0] * rows, columns, of=of, **places) as (drawn, panels):
        shown = [x for band in found.values() for x in band[:3]]
        # A sample that diverges does not flatten the bands.
        top = 10.0 * max(np.nanmax(np.abs(x), initial=0.0) for x in map(_finite, shown))
        shown += [np.where(x <= top, x, np.nan) for x in (b.worst for b in found.values())]
        limits = _limits(shown)
        for k, (panel, name) in enumerate(zip(panels, found, strict=True)):
            band = found[name]
            for other in found:
                if other != name:
                    panel.plot(time, _finite(found[other].median), color="0.75", lw=0.7)
            low, high = _finite(band.low), _finite(band.high)
            panel.fill_between(time, low, high, color=color(k), alpha=0.25, lw=0)
            gid = f"{name} worst"
            panel.plot(time, _finite(band.worst), color=color(k), lw=0.7, gid=gid)
            gid = f"{name} median"
            panel.plot(time, _finite(band.median), color=color(k), gid=gid)
            if bound is not None:
                panel.plot(time, bound, gid="bound", **_DASHED)
            panel.set_title(shortened(name, 30))
            _scaled(panel.yaxis, unit, limits)
            panel.set_xlim(time[0], time[-1])
            _ticks.linear(panel.xaxis, "s", 4)
            # The panel below carries the labels, where there is one.
            last = k + columns >= len(found) or axes is not None
            panel.tick_params(labelbottom=last, labelleft=k % columns == 0)
            panel.set_xlabel("time (s)" if last else "")
            panel.set_ylabel(with_unit("error", unit) if k % columns == 0 else "")
    return drawn


def ranking(
    study: Any,
    metric: str | Sequence[str] | None = None,
    *,
    confidence: float = 0.95,
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw the observers of a study from the best to the worst, one panel for each metric:
    their medians over the samples (dot), from 5 to 95 % (bar), the worst sample (tick, or
    an arrow where samples diverged or never settled), and where there is a Cramer-Rao bound
    it (dashed) and the rms that it bounds (diamond).

    **Arguments:**

    - `study`: the `xarray.Dataset` of [`aslo_jax.study.run`][];
    - `metric`: the name of one, or names, by default all that are numbers;
    - `confidence` (1) of the comparisons that rank them;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: one of its axes
      for each metric; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for a metric that the study has not, or axes that do not fit;
    `ImportError` naming the command that installs matplotlib.
    """
    from ..study._tables import metrics, table

    known = metrics(study)
    wanted = [metric] if isinstance(metric, str) else list(metric or known)
    if unknown := [name for name in wanted if name not in known]:
        raise ValueError(
            f"Argument `metric` must name metrics of the study, {', '.join(known)}, but "
            f"holds {', '.join(unknown)}."
        )
    if not wanted:
        raise ValueError("Argument `study` must hold a metric, but holds none.")
    seed = int(study.attrs.get("seed", 0))
    found = [table(study, name, confidence, seed) for name in wanted]
    return metrics_figure(found, figure, axes, ranked=True)


def metrics_figure(
    tables: Sequence["Table"], figure: Any = None, axes: Any = None, *, ranked: bool = False
) -> "Figure":
    """Every metric, observer by observer, if `ranked` the best first."""
    observers = list(tables[0].summaries)
    columns = 1 if len(tables) == 1 or axes is not None else 2
    rows = len(tables) if axes is not None else -(-len(tables) // columns)
    short = [shortened(name, 28) for name in observers]
    left = 0.2 + width_of(short, SETTINGS["font.size"])
    places = {"width": WIDTH, "inch": 0.1 + 0.24 * len(observers), "left": left}
    # Ranks differ from metric to metric: every panel has names of its own.
    places |= {"inner": left if ranked else 0.3, "top": 0.12, "gaps": 0.55}
    places |= {"count": len(tables)}
    of = "one for each metric"
    with drawing(figure, axes, [1.0] * rows, columns, of=of, **places) as (drawn, panels):
        for k, (panel, found) in enumerate(zip(panels, tables, strict=True)):
            order = [p.observer for p in found.places] if ranked else observers
            _metric(panel, found, order, {name: j for j, name in enumerate(observers)})
            panel.tick_params(labelleft=ranked or k % columns == 0)
    return drawn


def parameters_figure(parameters: Mapping[str, np.ndarray], figure: Any = None) -> "Figure":
    """How the spread parameters are distributed; values by label with unit."""
    columns = min(4, max(2, len(parameters)))
    rows = -(-len(parameters) // columns)
    places = {"width": WIDTH, "inch": 1.0, "left": 0.6, "inner": 0.4, "top": 0.12}
    places |= {"gaps": 0.55, "count": len(parameters)}
    of = "one for each parameter"
    with drawing(figure, None, [1.0] * rows, columns, of=of, **places) as (drawn, panels):
        for k, (panel, item) in enumerate(zip(panels, parameters.items(), strict=True)):
            _histogram(panel, item[1])
            panel.set_xlabel(shortened(item[0], 34), fontsize=8)
            panel.set_ylabel("samples" if k % columns == 0 else "")
    return drawn


def _bands(study: Any, t: Any, unit: str, bound: Any) -> "tuple[Any, Any, str, Any]":
    if isinstance(study, Mapping) and not hasattr(study, "sizes"):
        found: Mapping[str, Band] = {str(name): band for name, band in study.items()}
    else:
        from ..study._bands import bands as computed
        from ..study._tables import BOUND, unit as unit_of

        if "error" not in study:
            raise ValueError(
                "Argument `study` must hold `error` over time; run the study with "
                "trajectories (`record=`), or draw its metrics by `plot.ranking`."
            )
        found = computed(study["error"])
        t = study["time"].values if t is None else t
        unit = unit or unit_of(study["error"])
        if bound is None and BOUND in study:
            bound = study[BOUND].values
    if not found:
        raise ValueError("Argument `study` must hold the band of an observer.")
    shape = np.shape(next(iter(found.values())).median)
    for name, x in (("t", t), ("bound", bound)):
        if x is None and name == "bound":
            continue
        has = None if x is None else np.shape(x)
        if has != shape:
            raise ValueError(
                f"Argument `{name}` must have the shape {shape} of the bands, but has "
                f"{has}; pass the instants of the study."
            )
    return found, np.asarray(t, float), unit, None if bound is None else np.asarray(bound)


def _metric(
    axes: Any, table: "Table", order: Sequence[str], places: Mapping[str, int]
) -> None:
    drawn = [
        x for s in table.summaries.values() for x in (s.low.value, s.rms.value, s.worst)
    ]
    extent = _limits([np.array([*drawn, *([] if table.bound is None else [table.bound])])])
    finite = np.array([x for x in drawn if np.isfinite(x)] or [1.0])
    right = float(finite.max()) or 1.0
    if extent is None:
        edge, least = 1.05 * right, 0.0
        axes.set_xlim(0.0, 1.1 * right)
    else:
        least = extent[0]
        edge = right * (right / least) ** 0.08
        extent = least / 1.3, edge * (right / least) ** 0.03
    _scaled(axes.xaxis, table.unit, extent, 4)
    at = lambda x: min(max(x, least), edge)
    for row, name in enumerate(reversed(order)):
        found, look = table.summaries[name], {"color": color(places[name])}
        ends = [at(found.low.value), at(found.high.value)]
        axes.plot(ends, [row, row], lw=3.0, alpha=0.45, solid_capstyle="butt", **look)
        middle = at(found.median.value)
        axes.plot(middle, row, "o", ms=4.5, gid=f"{name} median", **look)
        worst = ">" if np.isinf(found.worst) else "|"
        axes.plot(at(found.worst), row, worst, ms=5.5, gid=f"{name} worst", **look)
        if table.bound is not None and np.isfinite(found.rms.value):
            axes.plot(found.rms.value, row, "D", ms=3.5, mfc="white", **look)
    if table.bound is not None:
        axes.axvline(table.bound, **_DASHED)
    names = [shortened(name, 28) for name in reversed(order)]
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.grid(False, axis="y")
    axes.set_xlabel(with_unit(table.label, table.unit))


def _histogram(axes: Any, values: np.ndarray) -> None:
    distinct = np.unique(values[:10_000])
    few = distinct.size <= 12
    if few:
        counts = [(values == x).sum() for x in distinct]
        width = 0.6 * (np.diff(distinct).min() if distinct.size > 1 else 1.0)
        axes.bar(distinct, counts, width=width, color="0.55")
        _ticks.linear(axes.xaxis, "", 4)
        axes.set_xticks(distinct if distinct.size <= 5 else distinct[:: distinct.size // 3])
    else:
        finite = values[np.isfinite(values)]
        counts, edges = np.histogram(finite, bins=min(40, 5 + int(np.sqrt(finite.size))))
        axes.stairs(counts, edges, fill=True, color="0.55")
        _ticks.linear(axes.xaxis, "", 3)
    _ticks.linear(axes.yaxis, "", 4)
    axes.grid(False, axis="x")


def _limits(series: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Of a logarithmic axis where what is drawn spans decades, from what is positive;
    otherwise `None`."""
    x = np.concatenate([np.ravel(s) for s in series])
    positive = x[np.isfinite(x) & (x > 0)]
    if positive.size == 0 or positive.size < 0.9 * np.isfinite(x).sum():
        return None
    # Round zeros at single instants do not stretch the axis over twenty decades.
    least = max(float(positive.min()), float(np.quantile(positive, 0.01)) / 10.0)
    if not positive.max() > _TALL * least:
        return None
    return least / 1.5, 1.5 * float(positive.max())


def _scaled(
    axis: Any, unit: str, limits: tuple[float, float] | None, most: int = 6
) -> None:
    if limits is None:
        _ticks.linear(axis, unit, most)
    else:
        _ticks.logarithmic(axis, unit, *limits, most)


def _finite(x: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(x), x, np.nan)
