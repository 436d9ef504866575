"""Design charts: the path of a descent, a loss over two leaves, a front of two costs."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _ticks
from ._canvas import drawing, legend
from ._style import color, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..tune import Fitted, Front, Surface


def tuning(
    fitted: "Fitted",
    *,
    names: Sequence[str] = (),
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw the loss, the parameters and the norm of the gradient over the iterations of
    every descent of [`aslo_jax.tune.fit`][], the best one in full colour.

    **Arguments:**

    - `fitted`: what `fit` returns, with descents of `K` iterations over `P` parameters;
    - `names` of the `P` parameters, with their units, such as `"cutoff (rad/s)"`;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: three of its
      axes; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for names or axes that do not fit; `ImportError` naming the
    command that installs matplotlib.
    """
    count = fitted.history.parameters.shape[1]
    if names and len(names) != count:
        raise ValueError(
            f"Argument `names` must hold {count} names, one for each tuned parameter, but "
            f"holds {len(names)}."
        )
    of = "of the loss, the parameters and the gradient"
    sizes = {"width": 6.5, "inch": 1.7, "sharex": True}
    with drawing(figure, axes, [1.0] * 3, of=of, **sizes) as (drawn, panels):
        values, slopes = panels[1:]
        for k, history in enumerate(fitted.histories):
            own = k == fitted.best
            marks = {
                "marker": ".",
                "alpha": 1.0 if own else 0.3,
                "zorder": 2.5 if own else 2,
            }
            panels[0].plot(history.loss, gid=f"loss {k}", color=color(0), **marks)
            for j, column in enumerate(history.parameters.T):
                name = names[j] if own and names else None
                gid = f"parameter {k}.{j}"
                values.plot(column, label=name, gid=gid, **style(j), **marks)
            gid = f"gradient {k}"
            slopes.plot(history.gradient_norm, gid=gid, color=color(0), **marks)
        every = fitted.histories
        _scaled(panels[0].yaxis, [h.loss for h in every])
        _scaled(values.yaxis, [h.parameters.ravel() for h in every])
        _scaled(slopes.yaxis, [h.gradient_norm for h in every])
        last = max(len(h.loss) for h in every) - 1
        for panel, label in zip(
            panels, ("loss", "parameters", "norm of the gradient"), strict=True
        ):
            panel.set_ylabel(label)
            panel.set_xlim(-0.02 * max(last, 1), 1.02 * max(last, 1))
            _ticks.linear(panel.xaxis, "", 8)
            panel.tick_params(labelbottom=panel is slopes)
        panels[0].set_title(fitted.stopped)
        slopes.set_xlabel("iteration")
        legend(values)
    return drawn


def landscape(
    fitted: "Fitted",
    over: "Surface",
    *,
    names: tuple[str, str] = ("lambda (rad/s)", "gamma (rad/s)"),
    label: str = "loss",
    marked: Mapping[str, tuple[float, float]] | None = None,
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw a loss over two leaves as contours, with the path of every descent to its
    minimum, where the best one began and where it ended.

    **Arguments:**

    - `fitted`: of two parameters, the leaves of `over`;
    - `over`: the loss, as [`aslo_jax.tune.surface`][] returns it;
    - `names` of the two leaves, with their units; `label` of the loss, with its unit;
    - `marked`: further points by name;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: one of its
      axes; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for a number of parameters or axes that does not fit, or a loss
    that is nowhere positive and finite; `ImportError` naming the command that installs
    matplotlib.
    """
    if fitted.parameters.size != 2:
        raise ValueError(
            "Argument `fitted` must have two parameters, those of `over`, but has "
            f"{fitted.parameters.size}; draw it by `plot.tuning`."
        )
    loss = np.where(np.isfinite(over.loss) & (over.loss > 0), over.loss, np.nan)
    if np.isnan(loss).all():
        raise ValueError(
            "Argument `over` must hold a loss that is positive and finite somewhere; "
            "compute it over other values of the leaves."
        )
    low, high = np.nanmin(loss), max(np.nanmax(loss), np.nanmin(loss) * 1.001)
    of = "of the contours"
    sizes: dict[str, Any] = {"width": 6.5, "inch": 4.2, "right": 0.3}
    with drawing(figure, axes, [1.0], of=of, **sizes) as (drawn, (panel,)):
        from matplotlib.colors import LogNorm

        # Levels are dense near the least loss, where a designer looks.
        levels = low * (high / low) ** (np.linspace(0.0, 1.0, 16) ** 2)
        contours = panel.contourf(
            over.first, over.second, np.ma.masked_invalid(loss.T), levels,
            norm=LogNorm(low, high), cmap="viridis_r",
        )  # fmt: skip
        bar = panel.figure.colorbar(contours, ax=panel, label=label)
        bar.ax.set_yticks(levels[::3], [f"{x:.3g}" for x in levels[::3]], minor=False)
        bar.ax.minorticks_off()
        for k, history in enumerate(fitted.histories):
            own = k == fitted.best
            look = {"color": "black", "lw": 1.4} if own else {"color": "0.5"}
            path, gid = "path" if own else None, f"path {k}"
            panel.plot(*history.parameters.T, ".-", label=path, gid=gid, **look)
        start, end = fitted.history.parameters[0], fitted.parameters
        panel.plot(*start, "s", color="black", markersize=7, label="start", gid="start")
        panel.plot(
            *end, "*", color=color(1), ms=15, mec="white", label="tuned", gid="tuned"
        )
        for k, (name, point) in enumerate((marked or {}).items()):
            look = {"color": "white", "markeredgecolor": "black", "gid": name}
            panel.plot(*point, "oD^v"[k % 4], label=name, **look)
        for axis, values in ((panel.xaxis, over.first), (panel.yaxis, over.second)):
            _ticks.logarithmic(axis, "", values.min(), values.max())
        panel.set(xlabel=names[0], ylabel=names[1])
        legend(panel)
    return drawn


def front(
    points: "Front",
    *,
    names: tuple[str, str] = ("transient", "noise"),
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw a Pareto front of two costs, on the samples that it was found with and on fresh
    ones, with the weights beside its points.

    **Arguments:**

    - `points`: what [`aslo_jax.tune.pareto`][] returns, of `K` weights;
    - `names` of the two costs, with their units;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: one of its
      axes; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for axes that do not fit; `ImportError` naming the command that
    installs matplotlib.
    """
    sizes: dict[str, Any] = {"width": 6.5, "inch": 3.6}
    with drawing(figure, axes, [1.0], of="of the front", **sizes) as (drawn, (panel,)):
        panel.plot(*points.costs.T, "o-", color=color(0), label="training", gid="training")
        panel.plot(
            *points.validation.T,
            "x--",
            color=color(1),
            label="unseen samples",
            gid="unseen",
        )
        for weight, point in zip(points.weights, points.costs, strict=True):
            text = f"w = {weight:.2g}"
            # On the side of lower costs, where neither line runs.
            aside: Any = {"xytext": (-5, -3), "textcoords": "offset points"}
            panel.annotate(text, point, ha="right", va="top", **aside)
        panel.margins(0.15)  # room for the weights
        for axis in (panel.xaxis, panel.yaxis):
            _ticks.linear(axis, "")
        panel.set(xlabel=names[0], ylabel=names[1])
        legend(panel)
    return drawn


def _scaled(axis: Any, series: list[np.ndarray]) -> None:
    """Logarithmic where everything is positive."""
    shown = np.concatenate(series)
    shown = shown[np.isfinite(shown)]
    if shown.size and (shown > 0).all():
        _ticks.logarithmic(axis, "", shown.min() / 1.2, shown.max() * 1.2)
    else:
        _ticks.linear(axis, "")
