"""Estimates over time: beside the truth, and their errors."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.typing import ArrayLike

from .._series import Track, instants, names_of, tracks
from .._text import symbol, with_unit
from . import _ticks
from ._canvas import drawing, legend
from ._lines import positive, shade, thinned
from ._style import BLACK, TRUTH, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 8.0  # inch


def estimate(
    found: Any,
    t: ArrayLike | None = None,
    truth: ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    units: Sequence[str] | str = "",
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw estimates over time beside the truth, one panel for each entry; grey where a
    single one coasts.

    **Arguments:**

    - `found`: an [`Estimate`][] of [`replay`][], a mapping of them by the name of their
      observer, or a [`Simulation`][], which knows its instants and its truth;
    - `t`: the instants that `replay` had (s), shape `(N,)`;
    - `truth`: in the units of the estimate, shape `(N, n)`; by default none is drawn;
    - `names` of the `n` entries, by default `value_0` and so on; `units` of each of them,
      or one unit for all;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: `n` of its
      axes; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for instants, a truth, names or axes that do not fit, and for a
    batch of estimates; `ImportError` naming the command that installs matplotlib.
    """
    each, t, truth = _together(found, t, truth)
    count = next(iter(each.values())).value.shape[1]
    labels = names_of(names, count, "value")
    every = [units] * count if isinstance(units, str) else list(units)
    if len(every) != count:
        raise ValueError(
            f"Argument `units` must hold {count} units, one for each entry of the "
            f"estimate, or be one for all, but is {every}."
        )
    of = "one for each entry of the estimate"
    sizes = {"width": _WIDTH, "inch": 1.5, "sharex": True}
    with drawing(figure, axes, [1.0] * count, of=of, **sizes) as (drawn, panels):
        for k, (panel, label, unit) in enumerate(zip(panels, labels, every, strict=True)):
            for j, (name, track) in enumerate(each.items()):
                x, gid = track.value[:, k], ".".join(filter(None, (name, label)))
                name = name or "estimate"
                panel.plot(*thinned(t, x), label=name, gid=gid, **style(j))
            if truth is not None:
                panel.plot(*thinned(t, truth[:, k]), label="truth", **TRUTH)
            if len(each) == 1:
                (track,) = each.values()
                shade(panel, t, track.coasting)
            panel.set_ylabel(with_unit(symbol(label), unit))
            _ticks.linear(panel.yaxis, unit)
            _over_time(panel, t, last=k + 1 == count)
        legend(panels[0])
    return drawn


def error(
    found: Any,
    t: ArrayLike | None = None,
    truth: ArrayLike | None = None,
    *,
    unit: str = "",
    threshold: float | None = None,
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw the Euclidean norm of the error of estimates over time, on a logarithmic axis,
    and below it their certificates; grey where a single one coasts.

    **Arguments:** `found`, `t`, `truth`, `figure` as in [`estimate`][], and

    - `unit` of the error, that of every entry;
    - `threshold`: a certificate (1) to be drawn as a line, such as that of a [`Guard`][];
    - `axes`: two, of the error and of the certificate.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** as [`estimate`][]; `ValueError` without a truth.
    """
    each, t, truth = _together(found, t, truth)
    if truth is None:
        raise ValueError(
            "Argument `truth` must be given for an estimate, shape (N, n); without one "
            "draw the estimate itself, `plot.estimate`."
        )
    sizes = {"width": _WIDTH, "inch": 0.85, "sharex": True}
    of = "of the error and of the certificate"
    with drawing(figure, axes, [3.0, 1.0], of=of, **sizes) as (drawn, (above, below)):
        errors = []
        for k, (name, track) in enumerate(each.items()):
            size = positive(np.linalg.norm(track.value - truth, axis=1))
            errors.append(size)
            gid, name = name or "error", name or "estimate"
            above.plot(*thinned(t, size), label=name, gid=gid, **style(k))
            shown = thinned(t, positive(track.certificate))
            below.plot(*shown, gid=f"{gid} certificate", lw=1.0, **style(k))
        if len(each) == 1:
            (track,) = each.values()
            shade(above, t, track.coasting)
            shade(below, t, track.coasting)
        _decades(above.yaxis, unit, errors)
        certificates = [positive(track.certificate) for track in each.values()]
        if threshold is not None:
            below.axhline(threshold, label="threshold", **(BLACK | {"linewidth": 0.8}))
            legend(below)
        _decades(below.yaxis, "", certificates, 3, shown=[1.0, threshold or 1.0])
        above.set_ylabel(with_unit("error", unit))
        below.set_ylabel("certificate (1)")
        _over_time(above, t, last=False)
        _over_time(below, t, last=True)
        legend(above)
    return drawn


def _together(
    found: Any, t: Any, truth: Any
) -> tuple[dict[str, Track], np.ndarray, np.ndarray | None]:
    """Estimates of one width, their instants and their truth."""
    each = tracks(found)
    if not each:
        raise ValueError("Argument `found` must hold an estimate, but holds none.")
    if hasattr(found, "hidden"):
        if t is not None or truth is not None:
            raise ValueError(
                "Arguments `t` and `truth` must be left out for a `Simulation`, which has "
                "both."
            )
        t, truth = found.t, found.hidden
    shapes = {name: track.value.shape for name, track in each.items()}
    shape = next(iter(shapes.values()))
    if len(set(shapes.values())) > 1:
        raise ValueError(
            f"Argument `found` must hold estimates of one shape, but theirs are {shapes}; "
            "draw those that differ one by one, each with its own truth."
        )
    if truth is not None:
        truth = np.asarray(truth, float)
        if truth.shape != shape:
            raise ValueError(
                f"Argument `truth` must have the shape {shape} of the estimate, but has "
                f"{truth.shape}; stack its entries, `numpy.stack([...], axis=1)`."
            )
    return each, instants(t, shape[0]), truth


def _over_time(axes: Any, t: np.ndarray, *, last: bool) -> None:
    axes.set_xlim(t[0], t[-1] if t[-1] > t[0] else t[0] + 1.0)
    if last:
        axes.set_xlabel("time (s)")
    _ticks.linear(axes.xaxis, "s", 8)
    axes.tick_params(labelbottom=last)


def _decades(
    axis: Any,
    unit: str,
    series: list[np.ndarray],
    most: int = 7,
    shown: Sequence[float] = (),
) -> None:
    """A logarithmic axis around what is drawn, with what must be `shown`."""
    x = np.concatenate(series)
    x = x[np.isfinite(x)]
    if x.size:
        # Single instants at which an error crosses zero do not stretch the axis.
        low = max(x.min(), np.quantile(x, 0.01) / 10.0, x.max() * 1e-15)
        low, high = min(low, *shown, low), max(x.max(), *shown, x.max())
        _ticks.logarithmic(axis, unit, low / 1.5, high * 1.5, most)
