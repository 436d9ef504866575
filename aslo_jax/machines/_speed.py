"""A cutoff for a log: how fast the flux in it turns."""

import math

import numpy as np
from jaxtyping import Float

PIECE = 64 << 14  # rows
WINDOW = 0.02  # s
TURN = 2.0  # rad, in the memory of a filter
SHARE = 0.05  # of a log, in which it may be less
SLOWEST = 40.0  # times slower than the typical speed: the least a memory is made for
CUTOFF = 1.0 / 15.0  # over the speed
FORGETTING = 1.6  # over the speed, or the drift where that is less
MINIMUM_CUTOFF = 5.0  # rad/s, what a log of a machine at rest gets


def median_interval(t: Float[np.ndarray, " N"]) -> float:
    """The median of the intervals between the instants `t`, in their unit."""
    return float(np.median(np.diff(t), overwrite_input=True))


def electrical_speed(
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N 2"],
    y: Float[np.ndarray, "N 2"],
    resistance: float,
) -> float:
    """The typical electrical speed of a log (rad/s), unsigned, without an observer, from
    voltages `u` (V), shape `(N, 2)`, and currents `y` (A), shape `(N, 2)`, at `t` (s),
    shape `(N,)`, with a phase `resistance` R (ohm): the `turning_speed` of `u - R i`
    (V), the derivative of the flux.
    """
    return turning_speed(t, u - resistance * y)


def turning_speed(t: Float[np.ndarray, " N"], v: Float[np.ndarray, "N 2"]) -> float:
    """The rate at which the vector v turns (rad/s), unsigned, averaged with its square as
    the weight; zero for one at rest. Against noise, samples are averaged over blocks in
    which it turns by about half a radian, and signed turns are summed over 64 blocks before
    their size is taken.
    """
    v, size, speed = _near_one(v), 1, 0.0
    for _ in range(8):  # noise makes the first speeds too large, the first blocks too short
        means, times = _blocks(v, size), _blocks(t, size)
        speed = _turning(times, means)
        wider = 0.5 * size / max(speed * median_interval(times), 1e-9)
        previous, size = size, int(np.clip(wider, size, max(t.size // 8, 1)))
        if size == previous:
            break
    return speed


def turning_acceleration(t: Float[np.ndarray, " N"], v: Float[np.ndarray, "N 2"]) -> float:
    """How fast that rate changes (rad/s^2): the difference from window to window of 20 ms,
    as the fourth root of the mean of its fourth power, so that a short run-up counts,
    weighted with the square of v; zero for a short log."""
    rows = max(round(WINDOW / median_interval(t)), 8)
    starts = np.arange(0, t.size - rows, rows)
    if starts.size < 2:
        return 0.0
    v = _near_one(v)
    turned, weight = np.zeros(starts.size), np.zeros(starts.size)
    for k, first in enumerate(starts):
        w, h = v[first : first + rows + 1], np.diff(t[first : first + rows + 1])
        turned[k] = np.sum(w[:-1, 0] * w[1:, 1] - w[:-1, 1] * w[1:, 0])
        weight[k] = np.sum(0.5 * np.sum(w[:-1] ** 2 + w[1:] ** 2, axis=1) * h)
    speed = turned / np.where(weight > 0, weight, 1.0)
    change = np.diff(speed) / np.diff(t[starts])
    both = np.minimum(weight[1:], weight[:-1])
    return float((np.sum(both * change**4) / max(both.sum(), 1e-300)) ** 0.25)


def _near_one(v: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
    """The vector, or where its squares may be no numbers, it over a power of two; a rate
    has the same bits of either."""
    largest = max(float(np.max(v, initial=0.0)), -float(np.min(v, initial=0.0)))
    if 1e-70 < largest < 1e70 or not math.isfinite(largest):
        return v
    return np.ldexp(v, -math.frexp(largest)[1])


def _blocks(x: Float[np.ndarray, "N *k"], size: int) -> Float[np.ndarray, "M *k"]:
    """The means of blocks of `size` rows, without what is left over."""
    if size == 1:
        return x
    blocks = x.shape[0] // size
    return x[: blocks * size].reshape(blocks, size, *x.shape[1:]).mean(axis=1)


def _turning(t: Float[np.ndarray, " M"], v: Float[np.ndarray, "M 2"]) -> float:
    """Piece by piece, since each of the products below is as long as the log."""
    turned = weight = 0.0
    for first in range(0, t.size - 1, PIECE):
        w, h = v[first : first + PIECE + 1], np.diff(t[first : first + PIECE + 1])
        turn = w[:-1, 0] * w[1:, 1] - w[:-1, 1] * w[1:, 0]
        square = 0.5 * np.sum(w[:-1] ** 2 + w[1:] ** 2, axis=1)
        turned += np.abs(np.add.reduceat(turn, np.arange(0, turn.size, 64))).sum()
        weight += np.sum(square * h)
    return float(turned / weight) if weight > 0 else 0.0


def cutoff_for(speed: float) -> float:
    """A cutoff (rad/s) for a typical electrical `speed` (rad/s): `speed / sqrt(3)`, where
    the paper's determinant is largest, and at least 5 rad/s (theory, section 9)."""
    return max(speed / math.sqrt(3.0), MINIMUM_CUTOFF)


def slow_speed(
    t: Float[np.ndarray, " N"], v: Float[np.ndarray, "N 2"], magnet_flux: float
) -> float:
    """The electrical speed (rad/s), unsigned, that a memory has to suit, of v (V), the
    derivative of the flux, and the magnet flux (Wb): `|v|` over that one. Of a log that
    turns steadily it is that speed; one with a slow part has less, so that nearly always a
    memory holds a turn of it; but at least a fortieth of the median: a log may well
    have rests, in which no memory helps."""
    interval, size, speed = median_interval(t), 1, 0.0
    means = np.zeros(0)
    for _ in range(8):  # against noise, over blocks in which the flux turns by 0.25 rad
        means = np.linalg.norm(_blocks(v, size), axis=1) / magnet_flux
        speed = float(np.median(means))
        wider = 0.25 / max(speed * interval, 1e-9)
        previous, size = size, int(np.clip(wider, size, max(t.size // 64, 1)))
        if size == previous:
            break
    if speed <= 0.0 or means.size < 16:
        return speed
    step = interval * t.size / means.size
    turns = np.concatenate([[0.0], np.cumsum(means)]) * step
    low, high = 1.0 / SLOWEST, 1.0
    for _ in range(12):
        middle = (low * high) ** 0.5
        rows = int(np.ceil(TURN / (middle * speed * step)))
        too_long = rows > means.size // 2
        if too_long or np.quantile(turns[rows:] - turns[:-rows], SHARE) < 0.8 * TURN:
            high = middle
        else:
            low = middle
    return low * speed


def two_rates(speed: float, drift: float) -> tuple[float, float]:
    """Cutoff and forgetting (rad/s) for a log with noise, of the [`slow_speed`][] `speed`
    and the `drift` (rad/s): the rate of the Kalman filter that sees of the flux, a random
    walk, half. Fitted on six motors."""
    speed = max(speed, MINIMUM_CUTOFF)
    return CUTOFF * speed, FORGETTING * speed * drift / (speed + drift)
