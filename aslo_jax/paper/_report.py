"""The files of a section: figures, their data, the claims, tables, and an index."""

import csv
import dataclasses
import io
from collections.abc import Sequence

from ..plot._figure import Figure
from ._claims import Claim, to_csv, to_markdown, to_text


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of numbers: `rows` of text by column, all with the same columns; `name` of
    its files; `title`; `caption`, a sentence or two that says what the columns are."""

    name: str
    title: str
    caption: str
    rows: Sequence[dict[str, str]]

    def csv(self) -> str:
        """One line per row."""
        out = io.StringIO()
        writer = csv.DictWriter(out, list(self.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return out.getvalue()

    def markdown(self) -> str:
        """A page."""
        columns = list(self.rows[0])
        lines = [f"# {self.title}", "", self.caption, ""]
        lines += [_cells(columns), "|" + "---|" * len(columns)]
        lines += [_cells(list(row.values())) for row in self.rows]
        return "\n".join(lines) + "\n"


def files(
    title: str,
    notes: str,
    figures: list[Figure],
    claims: list[Claim],
    tables: Sequence[Table] = (),
) -> tuple[dict[str, bytes], str]:
    """The content of every file by name, and a short table for the terminal."""
    content = {}
    for figure in figures:
        for kind, picture in figure.render("png", "pdf").items():
            content[f"{figure.name}.{kind}"] = picture
        content[f"{figure.name}.csv"] = figure.csv().encode()
    for table in tables:
        content[f"{table.name}.csv"] = table.csv().encode()
        content[f"{table.name}.md"] = table.markdown().encode()
    content["claims.csv"] = to_csv(claims).encode()
    content["claims.md"] = to_markdown(claims, f"{title}: claims").encode()
    content["index.md"] = index(title, notes, figures, tables).encode()
    return content, to_text(claims)


def index(
    title: str, notes: str, figures: list[Figure], tables: Sequence[Table] = ()
) -> str:
    """What each file holds."""
    lines = [
        f"# {title}",
        "",
        notes,
        "",
        "- [claims.md](claims.md), [claims.csv](claims.csv): every claim of the section, "
        "the number measured for it, and the verdict that follows.",
    ]
    for table in tables:
        name = table.name
        lines.append(f"- [{name}.md]({name}.md), [{name}.csv]({name}.csv): {table.caption}")
    for figure in figures:
        name, columns = figure.name, len(figure.data)
        lines.append(
            f"- [{name}.png]({name}.png), [{name}.pdf]({name}.pdf), [{name}.csv]"
            f"({name}.csv) ({columns} columns, each named with its unit): {figure.caption}"
        )
    return "\n".join(lines) + "\n"


def _cells(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
