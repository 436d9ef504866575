"""The page of errata, from what `aslo-jax paper --section all` has written."""

import csv
from pathlib import Path

from . import ROOT

PAGE = ROOT / "docs" / "errata.md"

HEAD = """\
# Errata of the paper

What `aslo-jax paper --section all --out paper` measures of the paper's claims: Bobtsov,
Romero, Ortega, Pyrkin, *An Algebraic State Observer for a Class of Physical Systems*. Each
claim is a number that is predicted and a number that is measured. *Confirmed* is a claim
whose prediction is met; *corrected* one whose correction is met instead. Formulas as
printed and as they hold are in [theory](theory.md#6-where-the-papers-print-differs), with
the derivations; this page is written by `python -m website errata paper`.
"""


def written(folder: Path) -> str:
    """The page, from a folder with `section_2/claims.csv` and so on.

    **Raises:** `FileNotFoundError` where there is none.
    """
    sections = sorted(folder.glob("section_*"))
    if not sections:
        raise FileNotFoundError(
            f"{folder} has no section_2: aslo-jax paper --section all --out {folder}"
        )
    lines = [HEAD]
    for section in sections:
        with (section / "claims.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        kinds = [row["verdict"].split(":")[0] for row in rows]
        lines += [
            f"## Section {section.name.rpartition('_')[2]}",
            "",
            f"{len(rows)} claims: {kinds.count('confirmed')} confirmed, "
            f"{kinds.count('corrected')} corrected, "
            f"{kinds.count('not reproduced')} not reproduced.",
            "",
            "| place | claim | measured | as claimed | as corrected | what holds |",
            "| --- | --- | --- | --- | --- | --- |",
            *(_row(row) for row in rows if not row["verdict"].startswith("confirmed")),
            "",
            "Confirmed: " + "; ".join(_confirmed(rows)) + ".",
            "",
        ]
    return "\n".join(lines)


def _row(row: dict[str, str]) -> str:
    measured = f"{float(row['measured']):.3g} {row['unit']}".rstrip()
    holds = row["verdict"].partition(": ")[2] or row["verdict"]
    cells = [row["place"], row["claim"], f"{row['quantity']}: {measured}"]
    cells += [row["as_claimed"], row["as_corrected"], holds]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _confirmed(rows: list[dict[str, str]]) -> list[str]:
    """The confirmed claims by name, with their place."""
    return [
        f"{row['name']} ({row['place']})" for row in rows if row["verdict"] == "confirmed"
    ]
