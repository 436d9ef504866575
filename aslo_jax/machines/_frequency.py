"""A cutoff for a log of positions: how fast a mechanism moves in it."""

import numpy as np
from jaxtyping import Float

from ._speed import median_interval

# On a leg, a ball and beam and a cart on an arm, 3 s at 1 kHz, factors of 5 to 20 gave
# median velocity errors below 1e-5 without noise and 3e-3 with encoders of 12 bits. With 1
# the start of the leg still shows (1e-3), and 5 % of mass too much show three times more.
FACTOR = 10.0
SLOWEST = 5.0  # rad/s, what a log of a mechanism at rest gets
PER_SAMPLE = 0.1  # most that a filter moves by from row to row
NOISE = 0.1  # von Neumann's ratio from which on a coordinate is taken for noise


def typical_frequency(t: Float[np.ndarray, " N"], q: Float[np.ndarray, "N n"]) -> float:
    """The typical frequency (rad/s) of the coordinate that moves fastest; zero at rest.
    Positions `q`, shape `(N, n)`, at `t` (s), shape `(N,)`.

    It is the rms velocity over the rms position, both about steady motion. Against noise,
    positions are averaged over blocks in which they move by about half a radian.
    """
    return max((_frequency(t, column) for column in q.T), default=0.0)


def _frequency(t: Float[np.ndarray, " N"], q: Float[np.ndarray, " N"]) -> float:
    interval, slope = median_interval(t), (q[-1] - q[0]) / (t[-1] - t[0])
    away = q - slope * (t - t[0])
    if np.mean(np.diff(away) ** 2) >= NOISE * np.var(away):
        return 0.0
    size, frequency = 1, 0.0
    for _ in range(8):  # noise makes the first velocities too large
        blocks = t.size // size
        times, means = (
            x[: blocks * size].reshape(blocks, size).mean(axis=1) for x in (t, away)
        )
        velocity = np.diff(means) / np.diff(times)
        frequency = float(velocity.std() / away.std())
        wider = 0.5 / max(frequency * interval, 1e-9)
        previous, size = size, int(np.clip(wider, size, max(t.size // 8, 1)))
        if size == previous:
            break
    return frequency


def cutoff_for_positions(
    t: Float[np.ndarray, " N"], q: Float[np.ndarray, "N n"]
) -> tuple[float, str]:
    """A cutoff (rad/s) for positions `q`, shape `(N, n)`, angles unwrapped, at `t` (s),
    shape `(N,)`, and why: ten times their typical frequency, at least 5 rad/s and at most a
    tenth of the sampling rate.
    """
    frequency = typical_frequency(t, q)
    fastest = PER_SAMPLE / median_interval(t)
    why = f"ten times {frequency:.4g} rad/s, the typical frequency of the positions"
    if FACTOR * frequency > fastest:
        return fastest, f"a tenth of the sampling rate, less than {why}"
    if FACTOR * frequency < SLOWEST:
        return min(SLOWEST, fastest), f"the least, more than {why}"
    return FACTOR * frequency, why
