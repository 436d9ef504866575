"""The files of a section: figures, their data, the claims, and an index."""

from .claims import Claim, to_csv, to_markdown, to_text
from .drawing import Figure


def files(
    title: str, notes: str, figures: list[Figure], claims: list[Claim]
) -> tuple[dict[str, bytes], str]:
    """The content of every file by name, and a short table for the terminal."""
    content = {}
    for figure in figures:
        content[f"{figure.name}.png"] = figure.png()
        content[f"{figure.name}.csv"] = figure.csv().encode()
    content["claims.csv"] = to_csv(claims).encode()
    content["claims.md"] = to_markdown(claims, f"{title}: claims").encode()
    content["index.md"] = index(title, notes, figures).encode()
    return content, to_text(claims)


def index(title: str, notes: str, figures: list[Figure]) -> str:
    """What each file holds."""
    lines = [
        f"# {title}",
        "",
        notes,
        "",
        "- [claims.md](claims.md), [claims.csv](claims.csv): every claim of the section, "
        "the number measured for it, and the verdict that follows.",
    ]
    for figure in figures:
        columns = len(figure.data)
        lines.append(
            f"- [{figure.name}.png]({figure.name}.png), [{figure.name}.csv]"
            f"({figure.name}.csv) ({columns} columns, each named with its unit): "
            f"{figure.caption}"
        )
    return "\n".join(lines) + "\n"
