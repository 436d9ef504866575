"""Rows that are lost from a log that is stamped evenly, told by the angle of what turns."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Complex, Float, Int

SIDES = (8, 24)  # rows before a loss, and after it: fewer where it is clear, more in noise
REACH = SIDES[0]  # rows that tell of others only what is not told of them
LEAST = 0.025  # rad: what is lost by less does little harm
MOST = 1.5  # rad: a jump that is larger may be anything
FAR = 9.0  # times the median of what looks like a jump
SURE = 6.0  # deviations of a jump: it is none by chance
AGREES = 4.0  # deviations by which jumps of two signals may differ
WHOLE = 0.3  # rows, or of a jump: as near it is to that of whole rows
MEDIAN = 0.6745  # of the size of normal noise, in deviations
FEW = 0.42  # of the squares that do not fit, in one entry: an outlier, and no noise
BLOCK = 10_000  # rows looked at at once


def losses(
    u: Complex[np.ndarray, " K"],
    y: Complex[np.ndarray, " K"],
    step: Complex[np.ndarray, " K"],
) -> Int[np.ndarray, " n"]:
    """After which of `K` rows some are lost: where voltage `u`, current `y` and the motion
    of the magnet over the interval, `step`, turn by whole rows at once.

    What turns evenly goes on by an angle that is a line of the number of the row, with a
    bend that is the same before and after. Where n rows are lost, the line of each of the
    three jumps by n times its slope. A step of the load does not turn all three alike.
    """
    found = np.zeros(0, int)
    angles = [_unwrapped(z) for z in (u, step, y)]
    for side in SIDES:
        if u.size >= 4 * side:
            more = _losses(angles, side)
            found = np.concatenate([found, apart(more, found, side)])
    return np.sort(found)


def apart(
    rows: Int[np.ndarray, " n"], others: Int[np.ndarray, " k"], reach: int
) -> Int[np.ndarray, " m"]:
    """Those rows that are more than `reach` from all others."""
    if not others.size:
        return rows
    return rows[np.abs(rows[:, None] - others).min(axis=1) > reach]


@dataclasses.dataclass(frozen=True)
class _Jumps:
    """By how much an angle jumps at each entry and turns there a row (rad), of lines
    through the entries before and after, the entry itself left out; the deviation of the
    jump, by how well these fit, infinite where few entries fit badly; and what of it is
    common."""

    size: Float[np.ndarray, " K"]
    slope: Float[np.ndarray, " K"]
    deviation: Float[np.ndarray, " K"]
    common: float


def _losses(angles: list[Float[np.ndarray, " K"]], side: int) -> Int[np.ndarray, " n"]:
    first, motion, other = (_jumps(angle, side) for angle in angles)
    size, slope = np.abs(first.size), first.slope
    rows = np.round(first.size / np.where(slope == 0.0, 1.0, slope))
    expected = rows * slope
    found = (rows >= 1) & (size < MOST)
    found &= size > np.maximum(max(LEAST, FAR * first.common), SURE * first.deviation)
    found &= np.abs(first.size - expected) < WHOLE * np.abs(slope)
    for jumps in (motion, other):
        doubt = np.maximum(WHOLE * size, AGREES * jumps.deviation)
        found &= np.abs(jumps.size - expected) < doubt
    found &= np.abs(motion.size) > AGREES * motion.deviation
    # Beside a loss the lines look alike; but the motion of its own interval is another one,
    # so that it fits where that one is left out.
    places = np.flatnonzero(found)
    groups = np.split(places, np.flatnonzero(np.diff(places) > side) + 1)
    best = [group[np.argmin(motion.deviation[group])] for group in groups if group.size]
    return np.array(best, int)


def _unwrapped(z: Complex[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    return np.concatenate([[0.0], np.cumsum(np.angle(z[1:] * z[:-1].conj()))])


def _jumps(angle: Float[np.ndarray, " K"], side: int) -> _Jumps:
    design, inverse = _lines(side)
    windows = np.lib.stride_tricks.sliding_window_view(angle, 2 * side + 1)
    parts = []
    for begin in range(0, windows.shape[0], BLOCK):
        around = windows[begin : begin + BLOCK]
        around = np.delete(around, side, axis=1) - around[:, [side]]
        fitted = around @ inverse.T
        rest = (around - fitted @ design.T) ** 2
        columns = fitted[:, -1], fitted[:, 1], rest.sum(axis=1), rest.max(axis=1)
        parts.append(np.column_stack(columns))
    size, slope, rest, worst = np.concatenate(parts).T
    freedom = design.shape[0] - design.shape[1]
    deviation = np.sqrt(rest / freedom * np.sum(inverse[-1] ** 2))
    # Differences of noise leave a line by much and move its mean by little.
    common = float(np.median(np.abs(size)))
    deviation *= min(1.0, common / MEDIAN / max(float(np.median(deviation)), 1e-300))
    deviation[worst > FEW * rest] = np.inf
    # Beyond the ends there is nothing.
    whole = lambda values, end: np.pad(values, side, constant_values=end)
    return _Jumps(whole(size, 0.0), whole(slope, 0.0), whole(deviation, np.inf), common)


@functools.cache
def _lines(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Two lines with a common bend, and what fits them."""
    x = np.concatenate([np.arange(-side, 0), np.arange(1, side + 1)])
    design = np.stack([np.ones(x.size), x, x**2, x > 0], axis=1)
    return design, np.linalg.pinv(design)
