"""Numbers in print."""

import math

from .._text import number as number, power as power
from ._statistics import Interval


def interval(x: Interval, scale: float = 1.0) -> str:
    """The ends of an interval, divided by `scale`."""
    return f"{number(x.low / scale)} to {number(x.high / scale)}"


def percent(x: float) -> str:
    """A proportion in per cent."""
    return f"{number(100.0 * x)} %"


def exponent_of(values: list[float]) -> int:
    """A power of a thousand by which to divide values so that they read well."""
    found = [abs(x) for x in values if math.isfinite(x) and x != 0.0]
    if not found:
        return 0
    least = 3 * math.floor(math.log10(min(found)) / 3.0)
    return 0 if min(found) >= 0.01 and max(found) < 1e4 else least


def chance(p: float) -> str:
    """A value of p."""
    return "< 0.0001" if p < 1e-4 else f"{p:.4f}"
