"""The timing of voltages, told by their leaps: what the current does in the same rows."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex

from ._circle import Circle
from ._rows import pace_of
from ._sample import Chunk
from ._timing import moved

SHIFTS = (0.0, -1.0, 1.0, -2.0, 2.0)  # rows that are compared
LEAP = 6.0  # times the median of what a voltage does from row to row: no noise
MOST = 64  # leaps of a chunk that are looked at
AROUND = 4  # rows before and after a leap
CURVE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0  # zero on cubic curves


def by_leaps(chunks: Sequence[Chunk], circle: Circle) -> dict[float, float]:
    """For voltages that are moved by some rows, how large is what they and the current
    leave of the flux of the magnet, which knows no leaps, around leaps of the voltage
    (V s, rms); empty where the voltage has none."""
    total = dict.fromkeys(SHIFTS, 0.0)
    count = 0
    for chunk in chunks:
        u, y, _ = circle.signals(chunk.u, chunk.y)
        if u.size < 8 * AROUND:
            continue
        rows = _around_leaps(u[:-1], chunk.broken)
        h = np.diff(chunk.t)
        drop = circle.resistance * 0.5 * (y[1:] + y[:-1])
        rest = h * drop + circle.inductance * np.diff(y)
        for shift in SHIFTS:
            left = _curve(h * moved(u, shift)[:-1] - rest)
            total[shift] += float(np.sum(np.abs(left[rows]) ** 2))
        count += rows.size
    return {s: (x / count) ** 0.5 for s, x in total.items()} if count else {}


def _around_leaps(u: Complex[np.ndarray, " N"], broken: np.ndarray) -> np.ndarray:
    """Rows beside the largest leaps of a voltage, away from rows that are broken."""
    size = np.abs(_curve(u))
    spoilt = np.convolve(broken[: u.size], np.ones(4 * AROUND + 1), "same") > 0.5
    ends = np.zeros(u.size, bool)
    ends[: 2 * AROUND] = ends[-2 * AROUND :] = True
    size = np.where(spoilt | ends, 0.0, size)
    quiet = float(np.median(size))
    leaps = np.argsort(size)[-MOST:]
    leaps = leaps[size[leaps] > LEAP * max(quiet, 1e-9 * float(np.abs(u).max()))]
    return np.unique(leaps[:, None] + np.arange(-AROUND, AROUND + 1))


def _curve(x: Complex[np.ndarray, " N"]) -> Complex[np.ndarray, " N"]:
    """What a curve has beside a cubic one, row by row, seen as it turns."""
    turn = pace_of(x) ** -np.arange(x.size)
    return np.convolve(x * turn, CURVE, "same")
