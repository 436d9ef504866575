"""Ticks: engineering prefixes, decades without mathtext, none that overlap."""

from typing import Any

import numpy as np

from .._extras import require
from .._text import mark

ticker = require("matplotlib.ticker", "plot")

# What no prefix of SI goes with.
_BARE = ("", "1", "%", "°", "deg", "rpm", "electrical degrees", "samples")
_FEW = 1e3  # below this ratio decades alone are too few labels


def formatter(unit: str) -> Any:
    """Of the numbers of an axis: with a prefix of SI where the `unit` takes one."""
    if unit in _BARE:
        return ticker.FuncFormatter(lambda x, _: mark(x))
    return ticker.EngFormatter(unit)


def linear(axis: Any, unit: str, most: int = 5) -> None:
    """At most so many intervals between round numbers."""
    axis.set_major_locator(ticker.MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]))
    axis.set_major_formatter(formatter(unit))


def logarithmic(axis: Any, unit: str, low: float, high: float, most: int = 7) -> None:
    """A logarithmic axis from `low` to `high`, at most about so many labels."""
    if axis.axis_name == "x":
        axis.axes.set(xscale="log", xlim=(low, high))
    else:
        axis.axes.set(yscale="log", ylim=(low, high))
    first, last = np.log10(low), np.log10(high)
    if high / low < 10.0:
        places = ticker.MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(low, high)
        places = places[places > 0]
    elif high / low < _FEW:
        decades = 10.0 ** np.arange(np.floor(first), np.ceil(last) + 1)
        places = np.outer(decades, (1.0, 3.0)).ravel()
        within = (places >= low) & (places <= high)
        places = places if within.sum() <= most else decades
    else:
        stride = max(1, int(np.ceil((last - first) / most)))
        stride = 3 if stride == 2 and unit not in _BARE else stride
        places = 10.0 ** np.arange(
            stride * np.floor(first / stride), np.ceil(last) + 1, stride
        )
    shown = places[(places >= low * (1 - 1e-9)) & (places <= high * (1 + 1e-9))]
    axis.set_major_locator(ticker.FixedLocator(shown))
    axis.set_minor_locator(ticker.NullLocator())
    axis.set_major_formatter(formatter(unit))


def without_mathtext(figure: Any) -> None:
    """Other formatters of a logarithmic axis, whose labels are mathtext, for plain ones."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(axis.get_major_formatter(), ticker.LogFormatterMathtext):
                axis.set_major_formatter(ticker.FuncFormatter(lambda x, _: mark(x)))
                axis.set_minor_formatter(ticker.NullFormatter())
