"""Which pages there are, and their order."""

import re
from functools import cache
from pathlib import Path

from . import ROOT
from ._notebooks import NOTEBOOKS, notebook_pages
from ._reference import reference_pages

NOTEBOOK = re.compile(r"\]\(\.\./notebooks/(\w+)\.ipynb")
# Every page of docs/ has its place here.
ORDER: dict[str, tuple[str, ...]] = {
    "Start": (
        "first-log",
        "logs",
        "from-a-datasheet",
        "conventions",
        "limits",
    ),
    "Tutorials": (
        "calibration",
        "tuning",
        "studies",
        "closed-loops",
        "disturbances",
        "mechanical-systems",
        "any-system",
        "writing-an-observer",
        "machine-descriptions",
        "figures",
        "batches",
        "firmware",
        "interop",
    ),
    "Methods": (
        "theory",
        "varying-rates",
        "quality",
        "robustness",
        "performance",
    ),
}


def navigation() -> list[dict[str, object]]:
    found: list[dict[str, object]] = [{"Home": "index.md"}]
    for section, names in ORDER.items():
        found.append({section: [f"{name}.md" for name in names]})
    notebooks = sorted(NOTEBOOKS.glob("*.ipynb"))
    found.append({"Notebooks": [f"notebooks/{each.stem}.md" for each in notebooks]})
    reference = sorted(each for each in reference_pages() if each != "reference/index.md")
    found.append(
        {
            "Reference": [
                "reference/index.md",
                *({Path(each).stem: each} for each in reference),
            ]
        }
    )
    return found


@cache
def pages() -> dict[str, str | bytes]:
    """The content of every page and picture by its path below the pages' folder."""
    found: dict[str, str | bytes] = {"index.md": front_page()}
    for page in sorted((ROOT / "docs").glob("*.md")):
        found[page.name] = NOTEBOOK.sub(r"](notebooks/\1.md", page.read_text("utf-8"))
    found |= notebook_pages()
    found |= reference_pages()
    found["site.css"] = (Path(__file__).parent / "site.css").read_text("utf-8")
    return found


def front_page() -> str:
    """README.md, its links those of the site."""
    text = (ROOT / "README.md").read_text("utf-8")
    return text.replace("](docs/", "](").replace("](notebooks)", "](index.md)")
