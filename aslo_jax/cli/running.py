"""A log read, estimated, written and summed up piece by piece."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ..logs import Log, LogReader, TableWriter
from ..machines import AbstractDescription
from ..machines.base import Rates
from . import table
from .summary import Summary
from .table import Estimator
from .trace import Trace


@dataclasses.dataclass(frozen=True)
class Done:
    """What is known of a table that was written; `slow`: why it was not done by machine
    code, if it was not."""

    summary: Summary
    trace: Trace
    slow: str

    def warnings(self) -> Iterator[str]:
        if self.slow:
            yield self.slow
        yield from self.summary.warnings()


def opened(
    path: Path,
    machine: AbstractDescription,
    given: Mapping[str, float],
    *,
    columns: Mapping[str, str],
    truth: bool,
    max_gap: float | None,
) -> tuple[LogReader, Rates]:
    """A log, read once and checked, and the rates of the observer for it."""
    watched: list[Log] = []
    known = not machine.chooses(given)
    reader = LogReader(
        path,
        machine.signals,
        columns=columns,
        truth=truth,
        max_gap=max_gap,
        watch=lambda log: None if known else watched.append(machine.condensed(log)),
    )
    if known:
        nothing = np.zeros((reader.t.size, 0))
        return reader, machine.rates_of(Log(reader.t, nothing, nothing, {}), given)
    joined = lambda pieces: np.concatenate(list(pieces))
    condensed = Log(
        reader.t, joined(x.u for x in watched), joined(x.y for x in watched), {}
    )
    watched.clear()
    return reader, machine.rates_of(condensed, given)


def tabulated(
    reader: LogReader,
    machine: AbstractDescription,
    rates: Rates,
    substeps: int,
    out: Path,
    drawn: bool,
    progress: Callable[[int], object],
) -> Done:
    """Write the table of estimates to `out`; `progress` is told of rows as they are done.

    A phase-locked loop starts where its angle is certified. Where it never is, which the
    end of the log tells, the loop starts in the first row: the log is run again."""
    for first in (None, 0):
        summary = Summary(reader, machine, rates, substeps)
        trace = Trace(machine, reader.t.size)
        estimator = Estimator(machine, rates, reader.t, substeps, first)
        with TableWriter(out) as writer:
            for log in reader.pieces(table.PIECE):
                piece = estimator(log)
                writer.write(piece.columns)
                summary.add(piece)
                if drawn:
                    trace.add(piece)
                if first is None:
                    progress(log.t.size - 1)
        if estimator.complete:
            break
    return Done(summary, trace, estimator.observed.slow)
