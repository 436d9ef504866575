"""A log read, estimated, written and summed up piece by piece."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from ..diagnosis import (
    FRAMES,
    Diagnosing,
    Diagnosis,
    Motion,
    Truth,
    of_stamps,
    repaired,
    retimed_pieces,
)
from ..logs import Log, LogReader, TableWriter
from ..machines import AbstractDescription
from ..machines._base import Rates
from ..machines._condensed import CondensedLog, Condensing
from ..machines._noise import pooled, white_noise
from . import _table as table
from ._summary import INCONSISTENT, Summary
from ._table import Estimator
from ._trace import Trace

# Kinds of what makes the rows of a log coast, which need not be said twice.
EXPLAIN = ("time_unit", "current_unit", "voltage_unit", "resistance_unit")


@dataclasses.dataclass(frozen=True)
class Done:
    """What is known of a table that was written, and of its log; `slow`: why it was not
    done by machine code, if it was not."""

    summary: Summary
    trace: Trace
    diagnosis: Diagnosis
    columns: tuple[str, ...]
    slow: str

    def warned(self) -> list[dict[str, Any]]:
        """The same as a file has them: `kind`, `message` and `rows` of every warning."""
        return [
            {"kind": kind, "message": message, "rows": list(rows)}
            for kind, message, rows in self.findings()
        ]

    def findings(self) -> Iterator[tuple[str, str, tuple[int, ...]]]:
        """Kind, message and rows of every warning."""
        if self.slow:
            yield "slow_engine", self.slow, ()
        for finding in self.diagnosis.warnings:
            yield finding.kind, finding.message, finding.rows
        known = any(f.kind in EXPLAIN for f in self.diagnosis.warnings)
        for kind, message in self.summary.warnings():
            if known and kind in ("not_certified", "mostly_coasting"):
                continue
            if kind == INCONSISTENT and self.diagnosis.warnings:
                continue
            yield kind, message, ()


def opened(
    path: Path,
    machine: AbstractDescription,
    given: Mapping[str, float],
    *,
    columns: Mapping[str, str],
    truth: bool,
    max_gap: float | None,
    **chain: Any,
) -> tuple[LogReader, Rates]:
    """A log, read once and checked, and the rates of the observer for it; `chain` is what
    else [`LogReader`][] takes."""
    condensing = Condensing(machine.condensed)
    known = not machine.chooses(given)
    reader = LogReader(
        path,
        machine.signals,
        columns=columns,
        truth=truth,
        max_gap=max_gap,
        watch=lambda log: None if known else condensing.add(log),
        **chain,
    )
    if known:
        nothing = np.zeros((reader.t.size, 0))
        condensed = CondensedLog(reader.t, nothing, nothing, {})
    else:
        condensed = condensing.result(reader.t)
    return reader, machine.rates_of(condensed, given)


def with_noise(
    reader: LogReader, machine: AbstractDescription, shift: float = 0.0
) -> tuple[AbstractDescription, dict[str, str]]:
    """The machine with the deviations of a log's noise, and where they come from, by key;
    its inputs moved by `shift` rows."""
    if not machine.lacks_noise:
        return machine, {}
    pairs = [circle.inputs for circle in machine.circles()]
    pieces = retimed_pieces(reader.pieces(table.PIECE), shift, pairs)
    groups = machine.noise_groups()
    return machine.with_noise(pooled([white_noise(x.u, x.y, *groups) for x in pieces]))


# What overflows is counted in the table, and said once.
@np.errstate(over="ignore", invalid="ignore")
def tabulated(
    reader: LogReader,
    machine: AbstractDescription,
    rates: Rates,
    substeps: int,
    out: Path | None,
    drawn: bool,
    progress: Callable[[int], object],
    *,
    align: bool = False,
    shift: float = 0.0,
    keep_outliers: bool = False,
    smoothed: bool = False,
    noise: Mapping[str, str] | None = None,
) -> Done:
    """Write the table of estimates to `out`, if anywhere; `progress` is told of rows as
    they are done. Inputs are moved by `shift` rows, and outliers are left out unless they
    are kept. `smoothed`: in one piece, each row from the whole log; `noise`: where the
    deviations come from, by key.

    A phase-locked loop starts where its angle is certified. Where it never is, which the
    end of the log tells, the loop starts in the first row: the log is run again. So it is
    to take the bias of angles from their errors, with `align`."""
    first, offsets, again = None, dict[str, float](), False
    names: tuple[str, ...] = ()
    while True:
        summary = Summary(reader, machine, rates, substeps, noise, smoothed)
        summary.offsets = offsets
        trace = Trace(machine, reader.t.size)
        motions: dict[str, Motion] = {}
        truths: dict[str, Truth] = {}
        circles = [c.read_from(reader.frame, reader.labels) for c in machine.circles()]
        diagnosing = Diagnosing(circles, reader.t.size, reader.interval, shift)
        estimator = Estimator(machine, rates, reader.t, substeps, first, offsets, smoothed)
        rows = reader.t.size if smoothed else table.PIECE
        with nullcontext() if out is None else TableWriter(out) as writer:
            pairs = [circle.inputs for circle in circles]
            for log in retimed_pieces(reader.pieces(rows), shift, pairs):
                suspect = diagnosing.add(log)
                if keep_outliers:
                    suspect = suspect.without_outliers()
                log = repaired(log, suspect)
                piece = estimator(log, suspect)
                if writer is not None:
                    writer.write(piece.columns)
                names = tuple(piece.columns)
                summary.add(piece)
                _compared(motions, machine, log, piece)
                _scaled(truths, machine, reader, piece)
                if drawn:
                    trace.add(piece, log)
                if not again:
                    progress(log.t.size - 1)
        again = True
        if not estimator.complete:
            first = 0
        elif align and not offsets and summary.biases():
            offsets = summary.biases()
        else:
            stamps = of_stamps(reader.t, machine.longest_interval, reader.labels["t"])
            verdict = diagnosing.result(keep_outliers)
            if any(finding.kind == "time_unit" for finding in stamps.warnings):
                # What else seems wrong, and is told in seconds, follows from that.
                verdict = dataclasses.replace(verdict, warnings=())
            if any(finding.kind == "coarse_time" for finding in stamps.warnings):
                verdict = _of_even_rows(verdict)
            verdict = stamps + verdict
            parts = [part.diagnosis() for part in motions.values()]
            if not any(finding.kind in FRAMES for finding in verdict.warnings):
                # What is wrong with the angle of the frame, any truth goes wrong with.
                parts += [part.diagnosis() for part in truths.values()]
            verdict = sum(parts, verdict)
            return Done(summary, trace, verdict, names, estimator.observed.slow)


def _of_even_rows(verdict: Diagnosis) -> Diagnosis:
    """Without rows that seem lost because instants are too coarse."""
    kept = tuple(f for f in verdict.warnings if f.kind not in ("lost_rows", "missing_rows"))
    return dataclasses.replace(verdict, warnings=kept)


def _compared(
    motions: dict[str, Motion], machine: AbstractDescription, log: Log, piece: table.Piece
) -> None:
    """Compare the velocities of a piece, but for the row that it shares with the one
    before, with the positions of the log."""
    suffixes = {q.columns[0]: q.suffix for q in machine.quantities}
    rows = piece.columns["t"].size
    for name, q in machine.positions(log).items():
        trusted = piece.columns[f"coasting{suffixes[name]}"] == 0
        motion = motions.setdefault(name, Motion(name))
        motion.add(piece.columns["t"], q[-rows:], piece.columns[name], trusted)


def _scaled(
    truths: dict[str, Truth],
    machine: AbstractDescription,
    reader: LogReader,
    piece: table.Piece,
) -> None:
    """Compare angles and speeds of a piece with their truth."""
    if machine.pole_pairs is None:
        return
    for quantity in machine.quantities:
        name = quantity.columns[0]
        if name not in piece.truth or not (quantity.angle or quantity.tracks):
            continue
        coasting = piece.columns[f"coasting{quantity.suffix}"]
        if quantity.tracks:
            coasting = coasting | piece.columns[f"coasting_{quantity.name}"]
        trusted = coasting == 0
        told = name.replace("electrical", "mechanical")
        mechanical = told in reader.truth and name not in reader.truth
        truth = truths.setdefault(
            name,
            Truth(
                told if mechanical else name,
                quantity.angle,
                machine.pole_pairs,
                mechanical,
            ),
        )
        truth.add(piece.columns[name][trusted], piece.truth[name][trusted])
