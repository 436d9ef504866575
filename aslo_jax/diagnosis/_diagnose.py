"""The diagnosis of a log: single rows piece by piece, then the log as a whole."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..logs import Log
from ._absent import absent_rows, beside_holes, bridged, long_holes
from ._circle import Circle
from ._repair import repaired, without
from ._rotations import FRAMES
from ._rows import Rows, gaps_in, suspect_rows
from ._sample import Sample
from ._value import Diagnosis, Finding
from ._verdict import of_circle

SHOWN = 5  # rows that a message names
# Kinds of what makes steps of the current look as if rows were lost.
WHOLE = (
    *("sign", "alpha_flipped", "beta_flipped", "axes_swapped", "axes_turned"),
    *("phases_swapped", "phases_a_b", "line_voltages", "power_invariant", "line_to_line"),
    *("current_unit", "voltage_unit", "current_scale", "voltage_scale", "inductance_unit"),
    *("voltage_timing", "voltage_instant"),
)
FEW = 2e-3  # of the rows: more that seem wrong are so by their frame


class Diagnosing:
    """The diagnosis of a log of `rows` rows, `interval` (s) apart, that comes piece by
    piece, each piece beginning with the last row of the one before.

    - `circles`: what its fluxes must satisfy, of its machine;
    - `shift`: the rows by which its inputs have been moved.

    Samples that are missing, not finite, are left alone: nothing is said of them or of the
    rows beside them.
    """

    def __init__(
        self, circles: Sequence[Circle], rows: int, interval: float, shift: float = 0.0
    ):
        self.circles, self.interval = tuple(circles), interval
        self._sample, self._seen = Sample(rows, shift=shift), 0
        self._turns = any(circle.frame == "dq" for circle in self.circles)
        self._read = Sample(rows, shift=shift)
        self._found: list[Rows] = []

    def add(self, log: Log) -> Rows:
        """The next piece; its rows that cannot be right."""
        begin = max(self._seen - 1, 0)
        absent = absent_rows(log)
        outliers = beside_holes(log, absent)
        whole = bridged(without(log, outliers), absent)
        each = [suspect_rows(whole, circle, self.interval) for circle in self.circles]
        found = _together(each) if each else _gaps(log, self.interval)
        found = found.away_from(absent).and_outliers(outliers)
        self._found.append(found.shifted(begin))
        broken = long_holes(whole, absent, self.circles)
        broken[found.lost] = True
        if self.circles:
            self._sample.add(repaired(whole, found), broken)
        if self._turns and log.angle is not None:
            self._read.add(bridged(log, absent), long_holes(whole, absent, self.circles))
        self._seen = begin + log.t.size
        return found

    def rows(self) -> Rows:
        """Every row that cannot be right."""
        return _joined(self._found)

    def result(self, kept: bool = False) -> Diagnosis:
        """The diagnosis, once every piece has come; `kept`: whether outliers are."""
        rows = self.rows()
        chunks, turning = self._sample.chunks(), self._read.chunks()
        if rows.count <= FEW * self._seen:  # single rows that are wrong, and are mended
            turning = chunks if turning else []
        found = Diagnosis()
        for circle in self.circles:
            turns = turning if circle.frame == "dq" else []
            found = found + of_circle(chunks, circle, turns)
        if any(w.kind in FRAMES for w in found.warnings):
            return found  # from which what rows seem wrong follows
        if any(w.kind in WHOLE for w in found.warnings):
            # What moves the current by more than the inputs allow is that first of all.
            rows = dataclasses.replace(rows, lost=rows.lost[:0])
        return Diagnosis(_of_rows(rows, kept)) + found


def diagnose(log: Log, circles: Sequence[Circle]) -> Diagnosis:
    """The diagnosis of a `log` in memory, by its time and by the `circles` on which its
    machine's residuals lie.
    """
    interval = float(np.median(np.diff(log.t)))
    diagnosing = Diagnosing(circles, log.t.size, interval)
    diagnosing.add(log)
    return diagnosing.result()


def _gaps(log: Log, interval: float) -> Rows:
    none = np.zeros(0, int)
    return Rows(none, none, none, *gaps_in(log.t, interval))


def _together(each: Sequence[Rows]) -> Rows:
    """What several equations say of the same rows."""
    if len(each) == 1:
        return each[0]
    union = lambda name: np.unique(np.concatenate([getattr(r, name) for r in each]))
    first = each[0]
    return Rows(
        union("outliers"), union("inputs"), union("lost"), first.gaps, first.missing
    )


def _joined(found: Sequence[Rows]) -> Rows:
    join = lambda name: np.concatenate([getattr(r, name) for r in found])
    names = [field.name for field in dataclasses.fields(Rows)]
    return Rows(**{name: join(name) for name in names})


LEFT = "left out (--outliers keep keeps them)"


def _of_rows(rows: Rows, kept: bool) -> tuple[Finding, ...]:
    found = []
    fate = "kept (--outliers drop leaves them out)" if kept else LEFT
    if rows.outliers.size:
        found.append(
            Finding(
                "outliers",
                f"the outputs of {_rows(rows.outliers)} cannot be right, far from what the "
                f"rows around say; {fate}",
                tuple(map(int, rows.outliers)),
            )
        )
    if rows.inputs.size:
        found.append(
            Finding(
                "input_outliers",
                f"the inputs of {_rows(rows.inputs)} cannot be right, far from what the "
                f"rows around say; {fate}",
                tuple(map(int, rows.inputs)),
            )
        )
    if rows.lost.size:
        found.append(
            Finding(
                "lost_rows",
                f"rows are lost after {_rows(rows.lost)}, although time goes on evenly: "
                "the outputs step by more than the inputs allow. The observer starts again "
                "there; record without losses, or with the true time",
                tuple(map(int, rows.lost)),
            )
        )
    if rows.gaps.size:
        total = int(rows.missing.sum())
        found.append(
            Finding(
                "missing_rows",
                f"{total} row{'s are' if total > 1 else ' is'} missing, as time tells, "
                f"after {_rows(rows.gaps)}; the inputs there are taken from those around",
                tuple(map(int, rows.gaps)),
            )
        )
    return tuple(found)


def _rows(rows: np.ndarray) -> str:
    shown = ", ".join(str(row) for row in rows[:SHOWN])
    more = f" and {rows.size - SHOWN} more" if rows.size > SHOWN else ""
    return f"row{'s' if rows.size > 1 else ''} {shown}{more}"
