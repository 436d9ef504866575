"""What the page draws, in numbers: panels of lines over time, and a table of errors."""

import base64
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ...logs import Log
from ...machines import AbstractDescription
from ...machines._base import Columns

DRAWN = 1500  # rows, at most
DEGREES = 180.0 / np.pi


@dataclasses.dataclass(frozen=True)
class Result:
    """What is known of a run.

    - `log`: the signals, with truth where it is known; `columns`: the tables of estimates
      by observer, with one `certificate` and one `coasting` each;
    - `machine`: whose quantities they are, as the observers take it to be;
    - `scale`: what each entry of the error is divided by in its norm;
    - `notes`: lines for a person.
    """

    log: Log
    columns: dict[str, Columns]
    machine: AbstractDescription
    scale: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def entries(self) -> dict[str, str]:
        """The columns whose error has a norm, and their units: what is estimated and is
        neither an angle nor what follows it; of one unit where they have no scale."""
        found = {
            name: quantity.unit
            for quantity in self.machine.quantities
            if not quantity.angle and quantity.tracks is None
            for name in quantity.columns
        }
        if self.scale is not None:
            return found
        first = next(iter(found.values()))
        alike = {n: u for n, u in found.items() if u == first}
        mixed = set(found.values()) <= {"m/s", "rad/s"}
        return found if mixed else alike

    def error(self, name: str) -> Float[np.ndarray, " N"] | None:
        """The norm of the error of an observer, if there is truth."""
        truth = self.machine.truth(self.log)
        entries = list(self.entries())
        if any(entry not in truth for entry in entries):
            return None
        scale = np.ones(len(entries)) if self.scale is None else self.scale
        each = [
            (self.columns[name][entry] - truth[entry]) / s
            for entry, s in zip(entries, scale, strict=True)
        ]
        return np.sqrt(np.sum(np.square(each), axis=0))

    def unit(self) -> str:
        """That of the norm of an error."""
        units = set(self.entries().values())
        return "" if self.scale is not None else ", ".join(sorted(units))

    def drawn(self) -> dict[str, Any]:
        """For the page: `t`, `panels` and `table`."""
        every = max(1, -(-self.log.t.size // DRAWN))
        rows = slice(None, None, every)
        notes = list(self.notes)
        if every > 1:
            notes.append(f"one in {every} samples is drawn")
        return {
            "t": packed(self.log.t[rows]),
            "panels": [p for p in self._panels(rows) if p["lines"]],
            "table": self._table(),
            "unit": self.unit(),
            "notes": notes,
        }

    def _panels(self, rows: slice) -> list[dict[str, Any]]:
        truth, names = self.machine.truth(self.log), list(self.columns)
        found = []
        # What is asked for most comes first: angle and speed of a motor, not its flux.
        derived = lambda q: not (q.angle or q.tracks is not None)
        for quantity in sorted(self.machine.quantities, key=derived):
            wrap = _wrapped if quantity.angle else lambda x: x
            for column in quantity.columns:
                lines = [
                    _line(name, wrap(self.columns[name][column][rows]))
                    for name in names
                    if column in self.columns[name]
                ]
                if column in truth:
                    lines.append(_line(None, wrap(truth[column][rows])))
                single = len(quantity.columns) == 1
                title = quantity.name if single else column.replace("_", " ")
                found.append(_panel(column, title, quantity.unit, lines, quantity.angle))
        errors = {name: self.error(name) for name in names}
        lines = [_line(n, e[rows]) for n, e in errors.items() if e is not None]
        title = "error, norm"
        if not lines:  # the band alone, of how far its runs are from each other
            title = "distance of the runs from their median"
            nothing = np.full(self.log.t[rows].size, np.nan)
            lines = [_line(name, nothing) for name in names]
        found.insert(0, _panel("error", title, self.unit(), lines, log=True))
        if "theta_electrical" in truth:
            error = lambda n: _wrapped(
                self.columns[n]["theta_electrical"] - truth["theta_electrical"]
            )
            lines = [_line(n, DEGREES * error(n)[rows]) for n in names]
            found.insert(1, _panel("angle_error", "angle error", "deg", lines))
        residuals: dict[str, list[Any]] = {}
        for name in names:
            for quantity, x in self._residuals(name).items():
                residuals.setdefault(quantity, []).append(_line(name, x[rows]))
        for quantity, lines in residuals.items():
            key = f"residual_{quantity.replace(' ', '_')}"
            found.append(_panel(key, f"residual, {quantity}", "1", lines, log=True))
        lines = [_line(n, self.columns[n]["certificate"][rows]) for n in names]
        for line, name in zip(lines, names, strict=True):
            line["coasting"] = packed(self.columns[name]["coasting"][rows])
        found.append(_panel("certificate", "certificate", "1", lines, log=True))
        return found

    def _residuals(self, name: str) -> Columns:
        """The residuals of an observer's table."""
        with np.errstate(all="ignore"):
            found = self.machine.residuals(self.columns[name], self.log)
        return {q: np.abs(x) for q, x in found.items()}

    def _table(self) -> list[dict[str, Any]]:
        """By observer: the rms and the peak of its error in the second half, the rms of the
        angle's (deg), and the share of rows that are certified."""
        late = slice(self.log.t.size // 2, None)
        truth, rows = self.machine.truth(self.log), []
        for name, columns in self.columns.items():
            error = self.error(name)
            row: dict[str, Any] = {"observer": name}
            if error is not None:
                row["rms"] = number(np.sqrt(np.mean(np.square(error[late]))))
                row["peak"] = number(np.max(error[late]))
            if "theta_electrical" in truth:
                angle = columns["theta_electrical"] - truth["theta_electrical"]
                rms = np.sqrt(np.mean(np.square(_wrapped(angle[late]))))
                row["angle"] = number(DEGREES * rms)
            residual = [np.mean(x[late]) for x in self._residuals(name).values()]
            row["residual"] = number(np.max(residual)) if residual else None
            row["certified"] = number(np.mean(columns["coasting"] == 0))
            rows.append(row)
        return rows


def packed(x: Any) -> str:
    """Numbers in single precision, base 64: a tenth of the time of JSON."""
    with np.errstate(over="ignore"):
        return base64.b64encode(np.ascontiguousarray(x, "<f4").tobytes()).decode()


def band_of(
    t: Float[np.ndarray, " T"], errors: Mapping[str, Float[np.ndarray, "runs T"]]
) -> dict[str, Any]:
    """The 5 %, 50 % and 95 % quantiles of the runs at every instant, by observer; what is
    not a number counts as infinite."""
    found = {}
    for name, error in errors.items():
        ordered = np.sort(np.where(np.isnan(error), np.inf, error), axis=0)
        runs = len(ordered)
        low, middle, high = (int(q * (runs - 1)) for q in (0.05, 0.5, 0.95))
        places = {"low": low, "middle": middle, "high": high}
        found[name] = {key: packed(ordered[place]) for key, place in places.items()}
        found[name]["runs"] = runs
    return {"t": packed(t), "bands": found}


def _line(observer: str | None, values: Any) -> dict[str, Any]:
    """Of an observer, or of the truth."""
    return {"observer": observer, "values": packed(values)}


def _panel(
    key: str,
    title: str,
    unit: str,
    lines: list[Any],
    wraps: bool = False,
    log: bool = False,
) -> dict[str, Any]:
    return {
        "id": key,
        "title": title,
        "unit": unit,
        "lines": lines,
        "wraps": wraps,
        "log": log,
    }


def _wrapped(angle: Any) -> Any:
    """The same angle in [-pi, pi) (rad)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def number(x: Any) -> float | None:
    """With four digits; nothing where it is not finite."""
    return float(f"{float(x):.4g}") if np.isfinite(x) else None
