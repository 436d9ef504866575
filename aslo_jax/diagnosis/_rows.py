"""Single rows of a log that cannot be right: outliers, and places where rows are lost."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from ..logs import Log
from ._circle import Circle
from ._turns import REACH, apart, losses

FAR = 9.0  # times the median distance from what the neighbours say
LEAST = 3e-3  # of the radius: what is smaller does little harm
LONGEST = 12  # rows of an outlier
SHORT = 0.6  # of the step of an outlier: one back that is smaller is not seen by itself
BEHIND = (-3, -2, -1)
NEIGHBOURS = (*BEHIND, 1, 2, 3)


NONE = np.zeros(0, int)


@dataclasses.dataclass(frozen=True)
class Rows:
    """Rows of a log that cannot be right, by their number, the first being 0; each an array
    of whole numbers.

    - `outliers`, shape `(a,)`: whose output is far off; `inputs`, shape `(b,)`: whose input
      is;
    - `lost`, shape `(c,)`: after which rows are missing although time goes on evenly;
    - `gaps`, shape `(d,)`: after which rows are missing, as time tells, and `missing`,
      shape `(d,)`: how many, each.
    """

    outliers: Int[np.ndarray, " a"]
    inputs: Int[np.ndarray, " b"]
    lost: Int[np.ndarray, " c"]
    gaps: Int[np.ndarray, " d"]
    missing: Int[np.ndarray, " d"]

    @property
    def count(self) -> int:
        """Of all of them."""
        named = (self.outliers, self.inputs, self.lost, self.gaps)
        return sum(map(len, named))

    def without_outliers(self) -> "Rows":
        """The same, no outliers among them."""
        return dataclasses.replace(self, outliers=NONE, inputs=NONE)

    def away_from(self, absent: Bool[np.ndarray, " N"]) -> "Rows":
        """The same, without those that touch rows whose samples are missing."""
        if not absent.any():
            return self
        near = absent.copy()
        near[1:] |= absent[:-1]
        near[:-1] |= absent[1:]
        kept = lambda rows: rows[~near[rows]]
        rest = ~near[self.gaps]
        return Rows(
            kept(self.outliers),
            kept(self.inputs),
            apart(self.lost, np.flatnonzero(absent), REACH),
            self.gaps[rest],
            self.missing[rest],
        )

    def and_outliers(self, rows: Int[np.ndarray, " k"]) -> "Rows":
        """The same, and some more outliers."""
        outliers = np.union1d(self.outliers, rows).astype(int)
        return dataclasses.replace(self, outliers=outliers)

    def shifted(self, rows: int) -> "Rows":
        """The same rows of a log that has `rows` more before them."""
        names = ("outliers", "inputs", "lost", "gaps")
        moved = {name: getattr(self, name) + rows for name in names}
        return Rows(**moved, missing=self.missing)


def suspect_rows(log: Log, circle: Circle, interval: float) -> Rows:
    """The rows that cannot be right of a log, or of a piece of one.

    `h (u - R i) - L di` from row to row is what the magnet moves by: a smooth curve. An
    output that is off moves it forth and back; lost rows move it once, by the step of the
    current that no voltage explains. Losses of few rows, whose step is as small as noise,
    turn it and the signals ([`losses`][]).
    """
    gaps, missing = gaps_in(log.t, interval)
    if log.t.size < 16:
        return Rows(NONE, NONE, NONE, gaps, missing)
    u, y, _ = circle.signals(log.u, log.y)
    h = np.diff(log.t)
    R, L = circle.resistance, circle.inductance
    leap = np.diff(y)
    step = h * (u[:-1] - 0.5 * R * (y[1:] + y[:-1])) - L * leap
    step = step * np.where(np.isin(np.arange(h.size), gaps), interval / h, 1.0)
    pace, turning = pace_of(step), pace_of(u)
    error = step - _smooth(step, pace, NEIGHBOURS)
    # By the entries before alone: where rows are lost, the curve jumps.
    behind = step - _smooth(step, pace, BEHIND)
    size = np.abs(error)
    quiet = np.median(size)
    least = LEAST * circle.radius if circle.radius and circle.other is None else 0.0
    limit = max(FAR * quiet, 0.15 * float(np.median(np.abs(step))), least)
    far = np.flatnonzero(size > limit)
    far = far[~np.isin(far, gaps)].tolist()
    pulses, moves = _pulses(u), h * u[:-1]
    outliers, inputs, lost = [], [], []
    taken = -1
    for k, place in enumerate(far):
        if place <= taken:
            continue
        # An output that is off by s moves the flux by -(L + h R/2) s, and on by L - h R/2.
        drop = 0.5 * R * h[place]
        back = (drop - L) / (L + drop)
        after = far[k + 1 : k + 4]
        if abs(back) < SHORT and place + 1 < size.size:
            after = [place + 1, *after]
        partner = _partner(error, after, place, back)
        if partner is not None and _jumps(y, place, partner, -error[place] / (L + drop)):
            outliers += range(place + 1, partner + 1)
            taken = partner
        elif _stands_out(u, turning, place, error[place] / h[place]):
            if not _answers(L * leap[max(place - 2, 0) : place + 3], size[place], quiet):
                inputs.append(place)
        elif not 3 <= place < step.size - 3 or pulses[place - 2 : place + 3].any():
            continue
        elif not _late(moves, step, pace, place, behind[place]) and any(
            _unexplained(x[place], L * leap[place], circle.saliency / L)
            for x in (error, behind)
        ):
            lost.append(place)
    as_rows = lambda found: np.array(sorted(set(found)), int)
    named = as_rows([*outliers, *inputs, *lost, *gaps.tolist()])
    lost += apart(losses(u[:-1], y[:-1], step), named, REACH).tolist()
    return Rows(as_rows(outliers), as_rows(inputs), as_rows(lost), gaps, missing)


def gaps_in(
    t: Float[np.ndarray, " N"], interval: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """The rows of a log after which rows are missing, and how many, each: where it is
    sampled every `interval` (s) but for them."""
    ratio = np.diff(t) / interval
    whole = np.round(ratio)
    even = np.abs(ratio - 1.0) < 0.05
    far = (whole >= 2) & (np.abs(ratio - whole) < 0.1 + 0.02 * whole)
    if not far.any() or np.mean(even | far) < 0.99 or np.mean(even) < 0.8:
        return NONE, NONE
    rows = np.flatnonzero(far)
    return rows, whole[rows].astype(int) - 1


def pace_of(x: Complex[np.ndarray, " N"]) -> complex:
    """By what a curve turns from entry to entry: a number of size one."""
    turn = np.vdot(x[:-1], x[1:])
    return complex(turn / abs(turn)) if abs(turn) > 0 else 1.0 + 0.0j


def _smooth(
    x: Complex[np.ndarray, " N"], turn: complex, neighbours: Sequence[int]
) -> Complex[np.ndarray, " N"]:
    """What the `neighbours` of every entry say it is: their median, the entry left out,
    turned to it at the pace at which the curve turns. At an end, where one is not there, it
    is the one as far on the other side."""
    rows = np.arange(x.size)
    inside = lambda k: (rows + k >= 0) & (rows + k < x.size)
    others = [np.where(inside(k), rows + k, rows - k) for k in neighbours]
    around = np.stack([x[other] * turn ** (rows - other) for other in others])
    return np.median(around.real, axis=0) + 1j * np.median(around.imag, axis=0)


def _late(moves: Any, step: Any, turn: complex, place: int, behind: Any) -> bool:
    """Whether the voltage of a row beside explains a step of the current, which then is no
    sign of a loss but of a late voltage; `moves`: what voltages move the flux by (V s).
    The curve of the magnet goes on as before then."""
    after = place + 4
    if place < 4 or after + 3 > step.size:
        return False
    rows = np.array([after, after + 1, after + 2])
    went_on = np.mean(step[rows] * turn ** (place - rows)) - (step[place] - behind)
    beside = np.array([-2, -1, 1, 2])
    left = np.abs(behind + moves[place + beside] * turn**-beside - moves[place])
    return bool(max(abs(went_on), left.min()) < 0.3 * abs(behind))


def _partner(error, after, place, back) -> int | None:
    """The step that takes an error back, if there is one soon, by `back` times it."""
    for other in after:
        if other - place > LONGEST:
            return None
        if abs(error[other] - back * error[place]) < 0.35 * abs(error[place]):
            return other
    return None


def _jumps(y: Any, place: int, partner: int, leap: Any) -> bool:
    """Whether the current really leaves its neighbours by `leap` between two steps."""
    if partner + 1 >= y.size:
        return False
    inside = y[place + 1 : partner + 1].mean() - 0.5 * (y[place] + y[partner + 1])
    return bool(abs(inside - leap) < 0.3 * abs(leap))


def _stands_out(u: Any, turn: complex, place: int, leap: Any) -> bool:
    if not 0 < place < u.size - 1:
        return False
    before, after = u[place - 1] * turn, u[place + 1] * np.conj(turn)
    if abs(after - before) > 0.5 * abs(leap):  # it does not come back: rows are lost
        return False
    own = u[place] - 0.5 * (u[place - 1] + u[place + 1])
    return bool(abs(own - leap) < 0.3 * abs(leap))


def _answers(leap: Any, size: Any, quiet: Any) -> bool:
    """Whether a current answers to a voltage of a row, though by less than it should, as
    one of another scale does; `leap`: of the rows around, times the inductance (V s)."""
    own = np.abs(leap - np.median(leap.real) - 1j * np.median(leap.imag)).max()
    largest = np.abs(leap).max()
    return bool(largest >= 0.3 * size or own >= max(0.08 * size, 4.0 * quiet))


def _pulses(u: Complex[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Where a voltage leaves its neighbours for one row. That moves a current by a step,
    which a wrong scale or a late voltage leave unexplained; where rows are lost there is
    none."""
    before, after = np.diff(u)[:-1], np.diff(u)[1:]
    back = np.real(before * after.conj()) < 0
    size = np.minimum(np.abs(before), np.abs(after)) * back
    # The steps of a voltage that turns evenly, and noise, are no pulses.
    turning = 2.0 * float(np.median(np.abs(before)))
    limit = max(6.0 * np.median(size), turning, 0.03 * np.median(np.abs(u)))
    return np.concatenate([[False], size > limit, [False]])


def _unexplained(error: Any, leap: Any, saliency: float) -> bool:
    """Whether most of the step of the current is what no voltage explains: all but one of
    `n + 1` intervals, where n rows are lost. A step of i_d leaves as much as the `saliency`
    (relative) of the machine."""
    share = -(error * np.conj(leap)).real / max(abs(leap) ** 2, 1e-300)
    return bool(0.4 + 0.5 * abs(saliency) < share < 1.6)
