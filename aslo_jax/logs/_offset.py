"""Offsets of voltages and currents that alternate: constants that should not be there."""

import dataclasses
import itertools
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex, Float

from ._error import Columns, LogError

ROTATING = ("u_alpha", "u_beta", "i_alpha", "i_beta")
Way = Literal["standstill", "periods"]
TURNS = 4  # of the voltage under a window
UNSURE = 0.3  # of an offset: means over periods that scatter by more tell nothing,
LEAST = 5e-3  # unless it is less than this part of the signal,
MOST = 0.02  # and those that scatter by more than this part may all be off alike
REST = 64  # rows of a standstill, at least
SMALL = 0.1  # of the largest voltage, and of the largest current: what a standstill has


@dataclasses.dataclass(frozen=True)
class Offset:
    """What is constant in alpha and beta of voltage and current, and was to be zero.

    - `voltage` (V), `current` (A): alpha + j beta;
    - `where`: what it was taken from, in words.
    """

    voltage: complex
    current: complex
    where: str

    def said(self) -> str:
        """In words."""
        u, i = self.voltage, self.current
        return (
            f"{u.real:.4g} V and {u.imag:.4g} V of the voltages (alpha, beta), "
            f"{i.real:.4g} A and {i.imag:.4g} A of the currents, from {self.where}"
        )

    def taken_from(self, columns: Columns) -> Columns:
        """The columns without it."""
        u, i = self.voltage, self.current
        each = zip(ROTATING, (u.real, u.imag, i.real, i.imag), strict=True)
        return columns | {name: columns[name] - x for name, x in each}


def check_way(way: str) -> None:
    """Refuse a way that is not known."""
    if way not in get_args(Way):
        raise LogError(
            "Argument `way` (option --remove-offset) must be standstill or periods, but is "
            f"{way!r}."
        )


def offset_of(
    t: Float[np.ndarray, " N"],
    u: Complex[np.ndarray, " N"],
    i: Complex[np.ndarray, " N"],
    way: str,
) -> Offset:
    """The offset of voltages `u` and currents `i`, alpha + j beta, at the instants `t` (s).

    - `way`: `"standstill"`, the mean of the longest stretch in which both are small and
      constant; or `"periods"`, the median of means over four turns of the voltage each,
      under Blackman's window, which is blind to what alternates there though amplitude and
      speed vary slowly.

    **Raises:** `LogError` where there is no such part.
    """
    check_way(way)
    there = np.isfinite(u) & np.isfinite(i)
    t, u, i = t[there], _despiked(u[there]), _despiked(i[there])
    return _of_standstill(t, u, i) if way == "standstill" else _of_periods(t, u, i)


def _of_periods(t, u, i) -> Offset:
    found = []
    for rows in _turns(t, u):
        for first, last in zip(rows[:-TURNS], rows[TURNS:], strict=True):
            part = slice(int(first), int(last) + 1)
            x = 2.0 * np.pi * (t[part] - t[first]) / (t[last] - t[first])
            window = 0.42 - 0.5 * np.cos(x) + 0.08 * np.cos(2.0 * x)
            window = window * np.gradient(t[part])
            found.append([window @ u[part], window @ i[part]] / window.sum())
    if len(found) < 2:
        raise LogError(
            f"--remove-offset periods needs {TURNS + 1} turns of the voltage one after the "
            f"other, none longer than a {TURNS}th of them all, but the log has none such; "
            "use --remove-offset standstill where the log has a standstill."
        )
    means = np.array(found)
    # Where the amplitude steps, a mean is far off: most others are not.
    middle = np.median(np.real(means), axis=0) + 1j * np.median(np.imag(means), axis=0)
    scatter = np.median(np.abs(means - middle), axis=0)
    for name, x, one, unsure in zip("ui", (u, i), middle, scatter, strict=True):
        size = np.sqrt(np.mean(np.abs(x) ** 2))
        if unsure > max(min(UNSURE * abs(one), MOST * size), LEAST * size):
            raise LogError(
                f"--remove-offset periods: the means of {name} over {TURNS} periods differ "
                f"by {unsure:.3g} around {abs(one):.3g}, too much to tell an offset, since "
                "amplitude or speed change within a few periods; use --remove-offset "
                "standstill, or a log of steady running."
            )
    turns = len(found) + TURNS - 1
    return Offset(complex(middle[0]), complex(middle[1]), f"{turns} or more periods")


def _turns(t, u) -> list[np.ndarray]:
    """The rows in which turns of `u` begin and end, of stretches in which it turns one
    way."""
    angle = np.unwrap(np.angle(_smooth(u)))
    marks = [0]
    for row in range(angle.size):
        if abs(angle[row] - angle[marks[-1]]) >= 2.0 * np.pi:
            marks.append(row)
    rows = np.array(marks)
    ways = np.sign(np.diff(angle[rows]))
    edges = [0, *(np.flatnonzero(np.diff(ways)) + 1).tolist(), ways.size]
    found = []
    for first, last in itertools.pairwise(edges):
        # Slow turns at the ends, from and to a standstill, are left out.
        while last - first >= TURNS:
            lengths = np.diff(t[rows[first : last + 1]])
            if lengths.max() <= lengths.sum() / TURNS:
                found.append(rows[first : last + 1])
                break
            if np.argmax(lengths) < lengths.size / 2:
                first += 1
            else:
                last -= 1
    return found


def _smooth(u: Complex[np.ndarray, " N"]) -> Complex[np.ndarray, " N"]:
    """A running mean over a twentieth of what seems to be a turn."""
    turn = abs(np.angle(np.vdot(u[:-3], u[3:]))) / 3.0 if u.size > 8 else 0.0
    size = min(int(2.0 * np.pi / 20.0 / max(turn, 1e-6)), max(u.size // 200, 1))
    if size < 2:
        return u
    total = np.concatenate([[0.0], np.cumsum(u)])
    ends = np.clip(np.arange(u.size) + size // 2 + 1, 0, u.size)
    begins = np.clip(np.arange(u.size) - size // 2, 0, u.size)
    return (total[ends] - total[begins]) / (ends - begins)


def _of_standstill(t, u, i) -> Offset:
    refused = LogError(
        f"--remove-offset standstill needs {REST} rows or more in which voltages and "
        f"currents stay below {SMALL:.0%} of their largest and do not change, but the log "
        "has none such; use --remove-offset periods where the motor turns."
    )
    small = np.ones(t.size, bool)
    for x in (u, i):
        # Against the noise of single rows.
        level = np.abs(_running(x, 8))
        small &= level < SMALL * np.quantile(level, 0.98)
    edges = np.flatnonzero(np.diff(np.r_[False, small, False])).reshape(-1, 2)
    if not edges.size:
        raise refused
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    # What happens at its ends belongs to what is around.
    margin = (last - first) // 8
    rows = slice(int(first + margin), int(last - margin))
    if rows.stop - rows.start < REST:
        raise refused
    for x in (u[rows], i[rows]):
        if not _steady(x):
            raise refused
    length = t[rows.stop - 1] - t[rows.start]
    where = f"{length:.3g} s of standstill from {t[rows.start]:.4g} s on"
    return Offset(complex(u[rows].mean()), complex(i[rows].mean()), where)


def _steady(x: Complex[np.ndarray, " N"]) -> bool:
    """Whether means of eighths of it differ by no more than noise makes them."""
    size = x.size // 8
    parts = x[: 8 * size].reshape(8, size).mean(axis=1)
    noise = float(np.sqrt(np.mean(np.abs(np.diff(x)) ** 2) / 2.0 / size))
    spread = float(np.sqrt(np.mean(np.abs(parts - parts.mean()) ** 2)))
    return bool(spread <= 4.0 * noise + 1e-3 * abs(x.mean()) + 1e-12)


def _running(x: Complex[np.ndarray, " N"], size: int) -> Complex[np.ndarray, " N"]:
    return np.convolve(x, np.ones(size) / size, mode="same")


def _despiked(x: Complex[np.ndarray, " N"]) -> Complex[np.ndarray, " N"]:
    """The median of every entry and its two neighbours: single outliers count nothing."""
    if x.size < 3:
        return x
    three = np.stack([x[:-2], x[1:-1], x[2:]])
    middle = np.median(np.real(three), axis=0) + 1j * np.median(np.imag(three), axis=0)
    return np.concatenate([x[:1], middle, x[-1:]])
