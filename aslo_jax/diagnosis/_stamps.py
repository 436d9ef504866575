"""What is wrong with the instants of a log: rounded, or of a clock that is too coarse."""

import shlex

import numpy as np
from jaxtyping import Float

from ._hypotheses import quoted
from ._value import Diagnosis, Finding

COARSE = 0.05  # of an interval: steps of the clock that are worth a warning
BEATS = 8  # intervals of two steps: as evenly apart by chance rows are not lost
MOST = 200_000  # rows that are looked at
UNITS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
SHORTEST = 1e-7  # s: no log is sampled faster


def of_stamps(t: Float[np.ndarray, " N"], longest: float, label: str = "t") -> Diagnosis:
    """The verdict on the instants `t` (s), shape `(N,)`, of a log, which calls them by
    `label`, of a machine whose median interval is below `longest` (s) in any sensible
    log."""
    interval = float(np.median(np.diff(t)))
    found = [*_unit(interval, longest, label), *_steps(t[:MOST])]
    return Diagnosis(tuple(found))


def step_of(t: Float[np.ndarray, " N"]) -> tuple[float, str]:
    """The step (s) in which instants are stamped, 0 where none is found, and why: they are
    rounded to few digits, or were single precision once."""
    largest = float(np.abs(t).max())
    for digits in range(10):
        step = 10.0**-digits
        scaled = t / step
        rounding = 1e-9 + 8.0 * np.finfo(float).eps * largest / step
        if np.abs(scaled - np.round(scaled)).max() < rounding < 0.1:
            return step, f"rounded to {step:.3g} s"
    single = t.astype(np.float32).astype(float)
    if np.array_equal(single, t):
        return float(np.spacing(np.float32(largest))), "of a clock in single precision"
    return 0.0, ""


def _steps(t: Float[np.ndarray, " N"]) -> list[Finding]:
    gaps = np.diff(t)
    if gaps.size < 16:
        return []
    mean = float(gaps.mean())
    step, why = step_of(t)
    if step < COARSE * mean or np.ptp(gaps) < 0.5 * step:
        return []
    # Rows that are missing from an even log leave whole intervals.
    whole = gaps / float(np.median(gaps))
    even = np.abs(whole - 1.0) < 1e-3
    # Even rows, stamped in steps: the instants leave a straight line by less than a step.
    off = t - t[0] - mean * np.arange(t.size)
    # So they do where a step is about an interval, and some intervals are two steps.
    beats = np.sum(~even) >= BEATS and np.ptp(off) < 1.5 * step
    wholes = np.mean(np.abs(whole - np.round(whole)) < 1e-3) > 0.99
    if wholes and even.mean() > 0.8 and not beats:
        return []
    if np.ptp(off) > 3.0 * step + 1e-9 * mean:
        even_words = ""
    else:
        even_words = (
            f"; the rows seem to come every {mean:.6g} s: write t as that times the number "
            "of the row"
        )
    message = (
        f"the instants are {why}, {100 * step / mean:.2g} % of the mean interval of "
        f"{mean:.4g} s: what is integrated over an interval is off by as much{even_words}; "
        "or write more digits, from a clock in double precision that starts at zero"
    )
    return [Finding("coarse_time", message)]


def _unit(interval: float, longest: float, label: str) -> list[Finding]:
    if interval <= longest:
        return []
    column = quoted(label)
    for name, factor in UNITS:
        if SHORTEST <= factor * interval <= longest:
            return [
                Finding(
                    "time_unit",
                    f"the log has {1.0 / interval:.4g} rows a second, too slow for this "
                    f"kind of machine: `{label}` may be in {name}, not in seconds; try "
                    f"--column {shlex.quote(f't={factor:g}*{column}')}",
                )
            ]
    return []
