"""What a calibration found: parameters with intervals, profiles, and what it leaves."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._text import with_unit
from . import _ticks
from ._canvas import drawing, legend
from ._style import color, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..tune import Calibration

ACROSS = 3  # profiles side by side, at most
BEFORE, AFTER = color(1), color(0)
_MARKS = ((1, "electrical frequency", color(4)), (6, "six times it", color(3)))
_SEGMENT = 512  # samples of a piece of Welch's spectrum, at most
_LABEL = 0.6  # inch: from an axis to the middle of its label
_FAR = 1.0  # relative: what is further from its estimate is drawn at the edge


def calibration(
    found: "Calibration",
    *,
    units: Mapping[str, str] | None = None,
    frequency: tuple[float, float] | None = None,
    figure: Any = None,
    axes: Any = None,
) -> "Figure":
    """Draw what [`aslo_jax.tune.calibrate`][] found, from the top: the parameters relative
    to their estimates, with intervals; the profile of the likelihood over each of them,
    its interval shaded; the spectrum of the prediction errors, which is flat where the
    model explains the log. What stands out at the electrical frequency is an offset, at
    six times it a dead time.

    **Arguments:**

    - `found`: of `k` parameters, and errors of the record that were fitted;
    - `units`: of the parameters by name, for instance `{"inductance": "H"}`;
    - `frequency`: the least and the greatest electrical frequency of the log (Hz), to be
      marked, with six times it;
    - `figure`: a figure or subfigure of matplotlib to draw into, or `axes`: `k + 2` of its
      axes; by default a new figure.

    **Returns:** the figure of matplotlib (the extra `plot`).

    **Raises:** `ValueError` for axes that do not fit; `ImportError` naming the command that
    installs matplotlib.

    Source: the spectrum is Welch's, 1967, doi:10.1109/TAU.1967.1161901.
    """
    columns = [1, *rows_of(len(found.estimate)), 1]
    heights = [parameters_height(found), *[1.0] * (len(columns) - 2), 1.0]
    sizes: dict[str, Any] = {"width": 9.0, "inch": 1.6, "left": 1.3, "inner": 0.75}
    of = "of the parameters, each of their profiles, and the spectrum"
    with drawing(figure, axes, heights, columns, of=of, gaps=0.75, **sizes) as (
        drawn,
        (first, *profiles, last),
    ):
        draw_parameters(first, found)
        draw_profiles(profiles, found, units or {}, columns[1:-1])
        draw_spectrum(last, found, frequency)
    return drawn


def rows_of(count: int) -> list[int]:
    """How many of so many panels stand in each row, as evenly as can be."""
    rows = -(-count // ACROSS)
    return [count // rows + (k < count % rows) for k in range(rows)]


def parameters_height(found: "Calibration") -> float:
    """Of the panel of the parameters, over that of the others."""
    return 0.25 + 0.13 * len(found.estimate)


def draw_parameters(axes: Any, found: "Calibration") -> None:
    """Start and estimate of every parameter, relative to the estimate."""
    limit = 0.0
    labelled: set[str] = set()

    def label(name: str) -> str | None:
        new = name not in labelled
        labelled.add(name)
        return name if new else None

    for k, (name, value) in enumerate(found.estimate.items()):
        size = abs(value) or 1.0
        ends = (np.array(found.interval[name]) - value) / size
        if np.isfinite(ends).all():
            ends = np.clip(ends, -_FAR, _FAR)
            limit = max(limit, float(np.max(np.abs(ends))))
            axes.plot(100 * ends, [k, k], "|-", color=AFTER, gid=f"interval {name}")
        sure = found.determined(name)
        look = {"color": AFTER, "markerfacecolor": AFTER if sure else "white"}
        text = "determined" if sure else "not determined"
        axes.plot(0.0, k, "o", label=label(text), gid=f"estimate {name}", **look)
        if found.before[name]:
            place = float(np.clip(found.before[name] / size - np.sign(value), -_FAR, _FAR))
            limit = max(limit, abs(place))
            look = {"color": BEFORE, "gid": f"before {name}"}
            axes.plot(100 * place, k, "D", ms=4, label=label("before"), **look)
    count = len(found.estimate)
    axes.set_yticks(range(count), list(found.estimate))
    axes.set_ylim(count - 0.4, -0.6)
    axes.set_xlim(-115 * (limit or 0.01), 115 * (limit or 0.01))
    _ticks.linear(axes.xaxis, "%", 8)
    axes.grid(False, axis="y")
    title = f"parameters, with intervals of {100 * found.confidence:g} %"
    axes.set(title=title, xlabel="from the estimate (%)")
    legend(axes)


def draw_profiles(
    panels: Sequence[Any],
    found: "Calibration",
    units: Mapping[str, str],
    columns: Sequence[int],
) -> None:
    """The deviance over each parameter, about its estimate."""
    first = np.cumsum([0, *columns])
    for k, (axes, (name, value)) in enumerate(
        zip(panels, found.estimate.items(), strict=True)
    ):
        unit, (places, deviance) = units.get(name, ""), found.profiles[name]
        ends = np.array(found.interval[name]) - value
        # Its root is straight where the deviance is a parabola.
        root = np.sign(places - value) * np.sqrt(np.maximum(deviance, 0.0))
        order = np.argsort(places)
        fine = np.linspace(places.min(), places.max(), 201)
        line = np.interp(fine, places[order], root[order]) ** 2
        axes.plot(fine - value, line, color=AFTER, gid=f"profile {name}")
        axes.plot(places - value, deviance, ".", color=AFTER, gid=f"places {name}")
        if np.isfinite(ends).all():
            axes.axvspan(*ends, color=AFTER, alpha=0.15, lw=0)
        seen = [*(places - value), *ends[np.isfinite(ends)]]
        low, high = min(seen), max(seen)
        room = 0.08 * ((high - low) or abs(value) or 1.0)
        axes.set_xlim(low - room, high + room)
        axes.set_ylim(0.0, 1.1 * (float(deviance.max()) or 1.0))
        _ticks.linear(axes.xaxis, unit, 3)
        _ticks.linear(axes.yaxis, "", 4)
        axes.set(title=name, xlabel=f"from {_around(found, name, unit)}")
        if k in first:
            axes.set_ylabel("deviance")
            inch = axes.get_window_extent().width / axes.figure.dpi
            axes.yaxis.set_label_coords(-_LABEL / max(inch, _LABEL), 0.5)


def _around(found: "Calibration", name: str, unit: str) -> str:
    """The estimate, with half the width of its interval."""
    write = _ticks.formatter(unit)
    value, half = found.estimate[name], found.half_width(name)
    known = f" ± {write(float(f'{half:.2g}'))}" if np.isfinite(half) else ", no interval"
    return f"{write(float(f'{value:.5g}'))}{known}"


def draw_spectrum(
    axes: Any, found: "Calibration", frequency: tuple[float, float] | None
) -> None:
    """The spectrum of the prediction errors (1/Hz), with what is to be found there."""
    import scipy.signal  # heavy to import

    t, errors = found.t, found.errors
    interval = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], interval)
    last = 0.5 / interval
    shown = []
    for k, e in enumerate(errors.T):
        x = np.interp(even, t, e)
        f, density = scipy.signal.welch(
            x, 1.0 / interval, nperseg=min(_SEGMENT, x.size), detrend="constant"
        )
        label = f"relation {k + 1}" if errors.shape[1] > 1 else None
        axes.plot(f[1:], density[1:], label=label, gid=f"spectrum {k}", **style(k))
        shown.append(density[1:])
    for times, label, look in _MARKS if frequency else ():
        low, high = (times * f for f in frequency or ())
        if low > last:
            continue
        middle, least = 0.5 * (low + high), 0.004 * last
        low, high = min(low, middle - least), max(high, middle + least)
        axes.axvspan(low, min(high, last), color=look, alpha=0.3, lw=0, label=label)
    every = np.concatenate(shown)
    every = every[(every > 0) & np.isfinite(every)]
    if every.size:
        _ticks.logarithmic(axes.yaxis, "", every.min() / 2, every.max() * 2, 5)
    axes.set_xlim(0.0, last)
    _ticks.linear(axes.xaxis, "Hz", 8)
    axes.set(
        title="spectrum of the prediction errors",
        xlabel="frequency",
        ylabel=with_unit("density", "1/Hz"),
    )
    legend(axes)
