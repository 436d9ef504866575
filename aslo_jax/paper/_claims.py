"""Claims: a statement, the number measured for it, and the verdict that follows."""

import csv
import dataclasses
import io
import math
import textwrap
from typing import NamedTuple


class Near(NamedTuple):
    """The measured number is `value` to within `tolerance`."""

    value: float
    tolerance: float

    def holds(self, x: float) -> bool:
        return bool(abs(x - self.value) <= self.tolerance)

    def __str__(self):
        return f"{self.value:.6g} +- {self.tolerance:.1g}"


class Below(NamedTuple):
    """The measured number is below `limit`."""

    limit: float

    def holds(self, x: float) -> bool:
        return bool(x < self.limit)

    def __str__(self):
        return f"< {self.limit:.6g}"


class Above(NamedTuple):
    """The measured number is above `limit`."""

    limit: float

    def holds(self, x: float) -> bool:
        return bool(x > self.limit)

    def __str__(self):
        return f"> {self.limit:.6g}"


Criterion = Near | Below | Above


@dataclasses.dataclass(frozen=True)
class Claim:
    """One claim, one measured number, and what each reading of the claim predicts for it.

    - `name`, unique; `place` in the paper; `claim`, quoted or paraphrased;
    - `quantity`: what was measured, in `unit`; `measured`: the number;
    - `printed`: what the claim predicts; `corrected`: what the correction predicts, and
      `correction` in words, where the claim does not hold;
    - `remark`: one sentence more.
    """

    name: str
    place: str
    claim: str
    quantity: str
    measured: float
    unit: str
    printed: Criterion
    corrected: Criterion | None = None
    correction: str = ""
    remark: str = ""

    @property
    def verdict(self) -> str:
        """`confirmed`, `corrected: ...` or `not reproduced`, from the measured number."""
        if math.isnan(self.measured):
            return "not reproduced"
        if self.printed.holds(self.measured):
            return "confirmed"
        if self.corrected is not None and self.corrected.holds(self.measured):
            return f"corrected: {self.correction}"
        return "not reproduced"


def to_csv(claims: list[Claim]) -> str:
    """One row per claim; the column `unit` holds the unit of the three numbers."""
    out = io.StringIO()
    rows = [_row(c) for c in claims]
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _row(c: Claim) -> dict[str, str]:
    return {
        "name": c.name,
        "place": c.place,
        "claim": c.claim,
        "quantity": c.quantity,
        "measured": f"{c.measured:.6g}",
        "unit": c.unit,
        "as_claimed": str(c.printed),
        "as_corrected": "" if c.corrected is None else str(c.corrected),
        "verdict": c.verdict,
        "remark": c.remark,
    }


def to_markdown(claims: list[Claim], title: str) -> str:
    """A page: the count of verdicts, a table, and one paragraph per claim."""
    lines = [
        f"# {title}",
        "",
        _count(claims),
        "",
        "Each verdict follows from the measured number: *confirmed* when it meets what the "
        "claim predicts, *corrected* when it meets what the correction predicts instead, "
        "*not reproduced* when it meets neither.",
        "",
        "| | place | quantity | measured | as claimed | as corrected | verdict |",
        "|---|---|---|---|---|---|---|",
    ]
    for c in claims:
        corrected = "" if c.corrected is None else str(c.corrected)
        cells = [c.name, c.place, c.quantity, f"{c.measured:.4g} {c.unit}".rstrip()]
        cells += [str(c.printed), corrected, c.verdict.split(":")[0]]
        lines.append("| " + " | ".join(x.replace("|", "\\|") for x in cells) + " |")
    for c in claims:
        remark = f" {c.remark}" if c.remark else ""
        lines += [
            "",
            f"**{c.name}** ({c.place}). {c.claim} *{_sentence(c.verdict)}*{remark}",
        ]
    return "\n".join(lines) + "\n"


def to_text(claims: list[Claim], columns: int = 118) -> str:
    """A short table for a terminal; verdicts are cut at `columns`."""
    rows = [("claim", "measured", "as claimed", "verdict")]
    for c in claims:
        measured = f"{c.measured:.4g} {c.unit}".rstrip()
        rows.append((c.name, measured, str(c.printed), c.verdict))
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    rest = max(columns - sum(widths) - 6, 20)
    lines = []
    for *cells, verdict in rows:
        padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        lines.append(
            "  ".join([*padded, textwrap.shorten(verdict, rest, placeholder=" ...")])
        )
    return "\n".join([*lines, _count(claims)])


def _count(claims: list[Claim]) -> str:
    kinds = [c.verdict.split(":")[0] for c in claims]
    counts = (f"{kinds.count(k)} {k}" for k in ("confirmed", "corrected", "not reproduced"))
    return f"{len(claims)} claims: {', '.join(counts)}."


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:].rstrip(".") + "."
