"""What is said of a log, as values."""

import dataclasses
from collections.abc import Iterator, Mapping


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log.

    - `kind`: a stable key, for programs;
    - `message`: likely cause and what to try, in one or two lines;
    - `rows`: of the log that it is about, the first being 0; none where it is about all;
    - `candidates`: where the kind is `undecided`, the kinds of the causes that explain the
      log alike, the likelier first.
    """

    kind: str
    message: str
    rows: tuple[int, ...] = ()
    candidates: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The verdict on a log.

    - `warnings`: none for a log in which nothing is found wrong;
    - `figures`: numbers behind it, by stable keys: `residual`, `noise` (relative to the
      radius), `radius` (Wb), `flux_error` (relative, what the cause that is named costs);
    - `notes`: what could not be looked at, in words.
    """

    warnings: tuple[Finding, ...] = ()
    figures: Mapping[str, float] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __add__(self, other: "Diagnosis") -> "Diagnosis":
        return Diagnosis(
            self.warnings + other.warnings,
            {**self.figures, **other.figures},
            self.notes + other.notes,
        )

    def lines(self) -> Iterator[str]:
        """The warnings in words."""
        for warning in self.warnings:
            yield warning.message
