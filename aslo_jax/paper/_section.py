"""A section of the paper: its experiments, and what is made of their runs."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from ..plot._figure import Figure
from ._claims import Claim
from ._report import Table, files

Printed = TypeVar("Printed")
Runs = TypeVar("Runs")


@dataclasses.dataclass(frozen=True)
class Section(Generic[Printed, Runs]):
    """What a section consists of.

    - `number` of the section; `notes`, a paragraph that precedes its files;
    - `printed`: what its claims are about, as functions of their gains. They are checked on
      whatever stands here, so that a wrong observer shows;
    - `run(printed)`: every experiment, run;
    - `figures`, `tables` and `claims`, made of the runs in the order of the paper.
    """

    number: int
    notes: str
    printed: Printed
    run: Callable[[Printed], Runs]
    figures: Sequence[Callable[[Runs], Figure]]
    claims: Callable[[Runs], list[Claim]]
    tables: Sequence[Callable[[Runs], Table]] = ()

    def report(self) -> tuple[dict[str, bytes], str]:
        """The files of the section by name, and a table for the terminal."""
        runs = self.run(self.printed)
        return files(
            f"Section {self.number} of the paper",
            self.notes,
            [figure(runs) for figure in self.figures],
            self.claims(runs),
            [table(runs) for table in self.tables],
        )
