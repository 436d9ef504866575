"""A cutoff for a log: how fast the flux in it turns."""

import math

import numpy as np
from jaxtyping import Float

MINIMUM_CUTOFF = 5.0  # rad/s, what a log of a machine at rest gets


def electrical_speed(
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N 2"],
    y: Float[np.ndarray, "N 2"],
    resistance: float,
) -> float:
    """The typical electrical speed of a log (rad/s), unsigned, without an observer.

    It is the rate at which `u - R i` (V), the derivative of the flux, turns, averaged with
    its square as the weight; zero for a motor at rest. Against noise, samples are averaged
    over blocks in which it turns by about half a radian, and signed turns are summed over
    64 blocks before their size is taken.
    """
    v, size, speed = u - resistance * y, 1, 0.0
    for _ in range(8):  # noise makes the first speeds too large, the first blocks too short
        blocks = t.size // size
        means = v[: blocks * size].reshape(blocks, size, 2).mean(axis=1)
        times = t[: blocks * size].reshape(blocks, size).mean(axis=1)
        speed = _turning(times, means)
        wider = 0.5 * size / max(speed * float(np.median(np.diff(times))), 1e-9)
        previous, size = size, int(np.clip(wider, size, max(t.size // 8, 1)))
        if size == previous:
            break
    return speed


def _turning(t: Float[np.ndarray, " M"], v: Float[np.ndarray, "M 2"]) -> float:
    turn = v[:-1, 0] * v[1:, 1] - v[:-1, 1] * v[1:, 0]
    square = 0.5 * np.sum(v[:-1] ** 2 + v[1:] ** 2, axis=1)
    turned = np.abs(np.add.reduceat(turn, np.arange(0, turn.size, 64))).sum()
    weight = np.sum(square * np.diff(t))
    return float(turned / weight) if weight > 0 else 0.0


def cutoff_for(speed: float) -> float:
    """A cutoff (rad/s) for a typical electrical `speed` (rad/s): `speed / sqrt(3)`, where
    the paper's determinant is largest, and at least 5 rad/s (theory, section 9)."""
    return max(speed / math.sqrt(3.0), MINIMUM_CUTOFF)
