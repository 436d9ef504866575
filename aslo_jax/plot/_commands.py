"""The figures of `aslo-jax tune` and `aslo-jax calibrate`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from . import _ticks
from ._calibration import (
    draw_parameters,
    draw_profiles,
    draw_spectrum,
    parameters_height,
    rows_of,
)
from ._canvas import Canvas, grid, legend, shortened, styled, width_of
from ._lines import positive, thinned
from ._style import SETTINGS, color

if TYPE_CHECKING:
    from ..tune import Calibration

_LOOKS = {"before": color(1), "after": color(0)}


def tuned_figure(errors: Mapping[str, tuple[float, float]], title: str) -> Canvas:
    """The rms errors of observers over fresh samples, before and after tuning."""
    names = [shortened(name, 40) for name in errors]
    with styled():
        canvas = Canvas(7.5, 0.4 * len(errors) + 1.2)
        left = 0.25 + width_of(names, SETTINGS["font.size"])
        ((axes,),) = grid(canvas, [1.0], left=left, top=0.5)
        for k, pair in enumerate(errors.values()):
            axes.plot(pair, [k, k], color="0.7", zorder=1)
            for value, (label, look) in zip(pair, _LOOKS.items(), strict=True):
                axes.plot(value, k, "o", color=look, label=None if k else label)
        finite = [x for pair in errors.values() for x in pair if 0 < x < np.inf]
        if finite:
            _ticks.logarithmic(axes.xaxis, "", min(finite) / 1.3, max(finite) * 1.3)
        axes.set_yticks(range(len(names)), names)
        axes.set(xlabel="rms error over fresh samples", title=shortened(title, 70))
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.grid(False, axis="y")
        legend(axes)
    return canvas


def calibrated_figure(
    found: "Calibration | None",
    t: Float[np.ndarray, " N"],
    residuals: Mapping[str, Mapping[str, Float[np.ndarray, " N"]]],
    formula: str,
    title: str,
    units: Mapping[str, str],
    frequency: tuple[float, float] | None,
) -> Canvas:
    """What [`aslo_jax.plot.calibration`][] draws, and below the profiles how far estimates
    are from their relation (1) over time (s), `"before"` and `"after"` calibration, one
    panel for each quantity; only these where nothing was found."""
    names = list(residuals["before"])
    across = [] if found is None else rows_of(len(found.estimate))
    columns, heights, gaps = [1] * len(names), [1.0] * len(names), [0.4] * (len(names) - 1)
    if found is not None:
        columns = [1, *across, *columns, 1]
        heights = [parameters_height(found), *[1.0] * len(across), *heights, 1.0]
        gaps = [0.75] * (1 + len(across)) + gaps + [0.75]
    with styled():
        canvas = Canvas(9.0, 1.5 * sum(heights) + sum(gaps) + 1.1)
        rows = grid(
            canvas, heights, columns, left=1.3, inner=0.75, top=0.6, gaps=gaps
        )  # fmt: skip
        place = 1.0 - 0.15 / canvas.get_figheight()
        canvas.text(0.1, place, shortened(title, 100), fontsize=10, va="center")
        first = 1 + len(across) if found is not None else 0
        for (axes,), name in zip(rows[first:], names, strict=False):
            drawn = {label: positive(residuals[label][name]) for label in _LOOKS}
            for label, x in drawn.items():
                axes.plot(*thinned(t, x), color=_LOOKS[label], lw=0.8, label=label)
            shown = np.concatenate(list(drawn.values()))
            shown = shown[np.isfinite(shown)]
            if shown.size:
                _ticks.logarithmic(axes.yaxis, "", shown.min() / 1.5, shown.max() * 1.5, 5)
            axes.set(title=f"{name}: {formula}", ylabel="relative (1)", xlim=(t[0], t[-1]))
            _ticks.linear(axes.xaxis, "s", 10)
            axes.tick_params(labelbottom=name == names[-1])
            legend(axes)
        rows[first + len(names) - 1][0].set_xlabel("time")
        if found is not None:
            draw_parameters(rows[0][0], found)
            profiles = [axes for row in rows[1:first] for axes in row]
            draw_profiles(profiles, found, units, across)
            draw_spectrum(rows[-1][0], found, frequency)
    return canvas
