"""Windows of a log in which what a turning flux must satisfy is looked at."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Complex, Float

from ._circle import Circle
from ._rows import pace_of
from ._sample import Chunk
from ._timing import moved

WINDOWS = 24  # at most
SAMPLES = 96  # of a window, at most: means of blocks of rows
TURNS = 1.25  # of the flux in a window: more would let noise of the voltage add up
ROWS = 48  # of a window, at least
# Shifts of the voltage (rows) that are compared. A held voltage that is moved by half a row
# is the mean of two neighbours: that of the instant.
SHIFTS = (-2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0)


@dataclasses.dataclass(frozen=True)
class Windows:
    """What a circle depends on, in `W` windows of `n` samples, alpha + j beta.

    - `t`: from the start of the window (s);
    - `voltage`, `current`: integrals from the start of its chunk (V s, A s); `shifted`:
      those of a voltage that is moved by so many rows;
    - `y`: the current (A); `radius`: what the radius follows, 1 for a magnet;
    - `dead`: the integral of the direction in which dead time acts (s);
    - `axis`: the direction of the d axis of a log in dq, by its angle;
    - `rate`: how fast the flux turns (rad/s); `interval` (s);
    - `drift`: by how much noise of voltage and current makes the integral of u - R i over a
      window leave a circle, rms, if all that is rough is noise (V s).
    """

    t: Float[np.ndarray, "W n"]
    voltage: Complex[np.ndarray, "W n"]
    current: Complex[np.ndarray, "W n"]
    y: Complex[np.ndarray, "W n"]
    radius: Float[np.ndarray, "W n"]
    dead: Complex[np.ndarray, "W n"]
    shifted: dict[float, Complex[np.ndarray, "W n"]]
    rate: float
    interval: float
    axis: Complex[np.ndarray, "W n"] | None = None
    drift: float = 0.0

    def only(self, chosen: Bool[np.ndarray, " W"]) -> "Windows":
        """Some of the windows."""
        arrays = ("t", "voltage", "current", "y", "radius", "dead")
        kept = {name: getattr(self, name)[chosen] for name in arrays}
        shifted = {shift: x[chosen] for shift, x in self.shifted.items()}
        axis = None if self.axis is None else self.axis[chosen]
        return dataclasses.replace(self, **kept, shifted=shifted, axis=axis)


def turning_rate(chunks: Sequence[Chunk], circle: Circle) -> float:
    """How fast `u - R i`, the derivative of the flux, turns (rad/s), forth or back: by one
    radian over the time in which it has half forgotten its direction, noise apart."""
    correlations: dict[int, list[float]] = {}
    interval = np.inf
    for chunk in chunks:
        u, y, _ = circle.signals(chunk.u, chunk.y)
        v = u - circle.resistance * y
        interval = min(interval, float(np.median(np.diff(chunk.t))))
        lag = 1
        while lag < v.size // 2:
            product = float(np.mean((v[lag:] * v[:-lag].conj()).real))
            correlations.setdefault(lag, []).append(product)
            lag = max(lag + 1, round(1.25 * lag))
    means = {lag: np.mean(products) for lag, products in correlations.items()}
    for lag, mean in means.items():
        if mean < np.cos(1.0) * means[1]:
            return 1.0 / (lag * interval)
    return 0.0


def windows_of(
    chunks: Sequence[Chunk],
    circle: Circle,
    rate: float,
    shifts: Sequence[float] = SHIFTS,
    most: int = WINDOWS,
    dead: bool = True,
) -> Windows | None:
    """Windows of `1.25` turns at `rate` (rad/s), at `most` so many, spread over the log,
    with the voltage at these `shifts` too and, where it is asked for, what `dead` time
    does; `None` where there is not a whole one."""
    interval = float(np.median(np.concatenate([np.diff(chunk.t) for chunk in chunks])))
    length = max(int(np.ceil(TURNS * 2.0 * np.pi / max(rate * interval, 1e-12))), ROWS)
    longest = max(chunk.t.size for chunk in chunks) - 5
    length = min(length, longest)
    if length < ROWS:
        return None
    places = [
        (k, first) for k, chunk in enumerate(chunks) for first in _firsts(chunk, length)
    ]
    if not places:
        return None
    chosen = np.unique(np.linspace(0, len(places) - 1, most).round().astype(int))
    sums = {
        k: _sums(chunks[k], circle, shifts, dead) for k in {places[c][0] for c in chosen}
    }
    noise = max(_noise(chunks[k], circle) for k in sums)
    parts = []
    for c in chosen:
        k, first = places[c]
        parts.append({name: _blocks(x, first, length) for name, x in sums[k].items()})
    stacked = {name: np.stack([part[name] for part in parts]) for name in parts[0]}
    t = np.real(stacked["t"]) - np.real(stacked["t"])[:, :1]
    return Windows(
        t,
        stacked["voltage"],
        stacked["current"],
        stacked["y"],
        np.real(stacked["radius"]),
        stacked["dead"],
        {s: stacked[f"shifted {s}"] for s in shifts},
        rate,
        interval,
        stacked.get("axis"),
        interval * noise * (length / 12.0) ** 0.5,
    )


def _noise(chunk: Chunk, circle: Circle) -> float:
    """Of u - R i (V), rms, without the few largest of its leaps."""
    u, y, _ = circle.signals(chunk.u, chunk.y)
    return float(np.hypot(_rough(u), circle.resistance * _rough(y)))


def _rough(x: Complex[np.ndarray, " N"]) -> float:
    """The noise of a signal that turns."""
    turn = pace_of(x)
    rough = x[2:] * turn.conjugate() - 2.0 * x[1:-1] + x[:-2] * turn
    return float(np.median(np.abs(rough) ** 2) / (6.0 * np.log(2.0))) ** 0.5


def _sums(
    chunk: Chunk, circle: Circle, shifts: Sequence[float], dead: bool
) -> dict[str, np.ndarray]:
    """Every series of a chunk, row by row."""
    u, y, radius = circle.signals(chunk.u, chunk.y)
    h = np.diff(chunk.t)
    total = lambda x: np.concatenate([[0.0], np.cumsum(x)])
    voltage = total(h * u[:-1])
    series = {
        "t": chunk.t - chunk.t[0],
        "voltage": voltage,
        "current": total(0.5 * h * (y[1:] + y[:-1])),
        "y": y,
        "radius": radius,
        "dead": total(h * _middle(circle.dead(y))) if dead else np.zeros_like(y),
    }
    for shift in shifts:
        series[f"shifted {shift}"] = total(h * moved(u, shift)[:-1])
    if chunk.angle is not None:
        series["axis"] = np.exp(1j * chunk.angle)
    return series


def _firsts(chunk: Chunk, length: int) -> list[int]:
    """The first rows of windows that have no broken row."""
    found, first = [], 2
    breaks = [*np.flatnonzero(chunk.broken).tolist(), chunk.t.size - 2]
    for last in breaks:
        while first + length <= last:
            found.append(first)
            first += length
        first = max(first, last + 1)
    return found


def _middle(x: np.ndarray) -> np.ndarray:
    return 0.5 * (x[1:] + x[:-1])


def _blocks(x: np.ndarray, first: int, length: int) -> np.ndarray:
    size = -(-length // SAMPLES)
    count = length // size
    return x[first : first + size * count].reshape(count, size).mean(axis=1)
