"""What a figure shows of a log of any length: all of a short one, and of a long one the
least and the largest value in every one of some thousand buckets, and both ends in full."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..logs import Log
from ..machines import AbstractDescription, Quantity
from ..machines._base import Columns
from ._summary import Summary, relative_error
from ._table import Piece

BUCKETS = 8_192  # several to a pixel
ENDS = 32_768  # rows of each end that are kept in full


@dataclasses.dataclass(frozen=True)
class View:
    """Rows to be drawn: `t` (s), `columns` and `truth` by the names of the table, what is
    drawn of errors by quantity, with gaps where it is not positive, and the measured
    `inputs` and `outputs` by the names of the log."""

    t: Float[np.ndarray, " N"]
    columns: Columns
    truth: Columns
    errors: Columns
    inputs: Columns
    outputs: Columns

    def between(self, first: float, last: float) -> "View":
        """The rows from `first` to `last` (s)."""
        rows = (self.t >= first) & (self.t <= last)
        cut = lambda columns: {name: x[rows] for name, x in columns.items()}
        parts = (self.columns, self.truth, self.errors, self.inputs, self.outputs)
        return View(self.t[rows], *map(cut, parts))


class Trace:
    """The rows of a log of `rows` rows that a figure shows, gathered piece by piece."""

    def __init__(self, machine: AbstractDescription, rows: int) -> None:
        self.machine, self.rows = machine, rows
        self._bucket = -(-rows // BUCKETS) if rows > 2 * BUCKETS else 1
        self._least: Columns = {}
        self._largest: Columns = {}
        self._first: list[Columns] = []
        self._last: list[Columns] = []
        self._done = 0

    def add(self, piece: Piece, log: Log | None = None) -> None:
        """The rows of a `piece`, and what was measured in them, the last rows of the `log`
        that it was estimated from."""
        series = {f"columns {k}": x for k, x in piece.columns.items()}
        for name, x in piece.columns.items():
            if name.startswith("certificate"):
                series[f"columns {name}"] = above_zero(x)
        series |= {f"truth {k}": x for k, x in piece.truth.items()}
        series |= {f"errors {k}": above_zero(x) for k, x in self._errors(piece).items()}
        rows = piece.columns["t"].size
        if log is not None:
            series |= self._measured(log, slice(log.t.size - rows, None))
        if self._bucket > 1:
            self._reduce(series, rows)
        if self._bucket == 1 or self._done < ENDS:
            self._first.append(series)
        if self._bucket > 1:
            self._last.append(series)
            while sum(_size(x) for x in self._last[1:]) >= ENDS:
                del self._last[0]
        self._done += rows

    def _measured(self, log: Log, rows: slice) -> Columns:
        signals = self.machine.signals
        inputs = (*signals.inputs, *signals.optional)  # the latter are zero where missing
        found = {}
        for kind, names, values in (
            ("inputs", inputs, log.u),
            ("outputs", signals.outputs, log.y),
        ):
            columns = zip(names, values[rows].T, strict=False)
            found |= {f"{kind} {name}": x for name, x in columns}
        return found

    def _errors(self, piece: Piece) -> Columns:
        """By quantity: of vectors where there are any, of scalars yet to be divided by the
        rms of their truth, or the residuals."""
        if not piece.truth:
            return piece.residuals
        known = [q for q in self.machine.quantities if set(q.columns) <= piece.truth.keys()]
        if vectors(self.machine):
            return {q.name: relative_error(q, piece) for q in known if len(q.columns) > 1}
        return {q.name: np.abs(piece.columns[f"error_{q.columns[0]}"]) for q in known}

    def _reduce(self, series: Columns, rows: int) -> None:
        numbers = (self._done + np.arange(rows)) // self._bucket
        starts = np.flatnonzero(np.diff(numbers, prepend=-1))
        places = numbers[starts]
        for name, x in series.items():
            for kept, extreme in ((self._least, np.fmin), (self._largest, np.fmax)):
                whole = kept.setdefault(name, np.full(self._buckets, np.nan))
                whole[places] = extreme(whole[places], extreme.reduceat(x, starts))

    @property
    def _buckets(self) -> int:
        return -(-self.rows // self._bucket)

    def whole(self, summary: Summary) -> View:
        """The whole log."""
        if self._bucket == 1:
            return self._view(_joined(self._first), summary)
        both = {
            name: np.stack([x, self._largest[name]], axis=1).ravel()
            for name, x in self._least.items()
        }
        both["columns t"] = np.repeat(self._least["columns t"], 2)
        for name in list(both):
            if name.startswith("columns coasting"):
                both[name] = np.repeat(self._largest[name], 2)
        return self._view(both, summary)

    def tail(self, summary: Summary) -> View:
        """The last rows in full, or all of a short log."""
        return self._view(_joined(self._last or self._first), summary)

    def end(self, whole: View, window: float, summary: Summary, *, last: bool) -> View:
        """The first or the last `window` seconds of the log."""
        t = summary.reader.t
        ends = (t[-1] - window, t[-1]) if last else (t[0], t[0] + window)
        if self._bucket > 1:
            full = self._view(_joined(self._last if last else self._first), summary)
            if full.t[0] <= ends[0] and full.t[-1] >= ends[1]:
                return full.between(*ends)
        return whole.between(*ends)

    def _view(self, series: Columns, summary: Summary) -> View:
        kinds = ("columns", "truth", "errors", "inputs", "outputs")
        parts: dict[str, Columns] = {kind: {} for kind in kinds}
        for name, x in series.items():
            kind, _, of = name.partition(" ")
            parts[kind][of] = x
        if parts["truth"] and not vectors(self.machine):
            for quantity in self.machine.quantities:
                if quantity.name in parts["errors"]:
                    size = summary.all_sizes[quantity.columns[0]].rms
                    scaled = parts["errors"][quantity.name] / (size or np.nan)
                    parts["errors"][quantity.name] = scaled
        return View(parts["columns"]["t"], **parts)


def vectors(machine: AbstractDescription) -> list[Quantity]:
    return [quantity for quantity in machine.quantities if len(quantity.columns) > 1]


def above_zero(x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """`x` with gaps where it is not positive or not finite, for a logarithmic axis."""
    return np.where((x > 0) & np.isfinite(x), x, np.nan)


def _size(series: Mapping[str, np.ndarray]) -> int:
    return series["columns t"].size


def _joined(pieces: list[Columns]) -> Columns:
    return {name: np.concatenate([p[name] for p in pieces]) for name in pieces[0]}
