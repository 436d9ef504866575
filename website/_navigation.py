"""Which pages there are, and their order."""

import re
from functools import cache
from pathlib import Path

from . import ROOT
from ._gallery import SECTIONS, gallery_pages
from ._notebooks import NOTEBOOKS, notebook_pages
from ._reference import reference_pages

LINKS = (
    (re.compile(r"\]\(\.\./notebooks/(\w+)\.ipynb"), r"](notebooks/\1.md"),
    (re.compile(r"\]\(gallery/README\.md"), r"](gallery/index.md"),
    (re.compile(r"\]\(gallery/(\w+)\.py"), r"](gallery/\1.md"),
)
# Every page of docs/ has its place here.
ORDER: dict[str, tuple[str, ...]] = {
    "Start": (
        "start",
        "first-log",
        "which-observer",
        "logs",
        "from-a-datasheet",
        "conventions",
        "limits",
        "questions",
    ),
    "Tutorials": (
        "calibration",
        "tuning",
        "studies",
        "explorer",
        "closed-loops",
        "continuous-time",
        "disturbances",
        "mechanical-systems",
        "any-system",
        "writing-an-observer",
        "machine-descriptions",
        "figures",
        "batches",
        "firmware",
        "interop",
        "small-examples",
    ),
    "Methods": (
        "theory",
        "errata",
        "observers",
        "plants",
        "modelled-plants",
        "varying-rates",
        "quality",
        "robustness",
        "performance",
    ),
    # Before the modules.
    "Reference": ("commands", "symbols"),
}


def navigation() -> list[dict[str, object]]:
    """Tabs, in each a list of pages, as MkDocs and Zensical read it."""
    sections: dict[str, list[object]] = {
        name: [f"{page}.md" for page in pages] for name, pages in ORDER.items()
    }
    notebooks = [f"notebooks/{each.stem}.md" for each in sorted(NOTEBOOKS.glob("*.ipynb"))]
    sections["Tutorials"].append({"Notebooks": notebooks})
    gallery: list[object] = ["gallery/index.md"]
    gallery += (
        {section: [f"gallery/{name}.md" for name in names]}
        for section, names in SECTIONS.items()
    )
    modules = sorted(each for each in reference_pages() if each != "reference/index.md")
    reference = sections.pop("Reference")
    reference += [
        "reference/index.md",
        {"Modules": [{Path(each).stem: each} for each in modules]},
    ]
    found: list[dict[str, object]] = [{"Home": "index.md"}]
    for name, pages in sections.items():
        found.append({name: pages})
        if name == "Start":
            found.append({"Gallery": gallery})
    return [*found, {"Reference": reference}]


@cache
def pages() -> dict[str, str | bytes]:
    """The content of every page and picture by its path below the pages' folder."""
    found: dict[str, str | bytes] = {"index.md": front_page()}
    for page in sorted((ROOT / "docs").glob("*.md")):
        found[page.name] = to_pages(page.read_text("utf-8"))
    for picture in sorted((ROOT / "docs").glob("*.png")):
        found[picture.name] = picture.read_bytes()
    found |= notebook_pages() | gallery_pages()
    found |= reference_pages()
    found["site.css"] = (Path(__file__).parent / "site.css").read_text("utf-8")
    return found


def to_pages(text: str) -> str:
    """A page of `docs/`, its links to notebooks and scripts those to their pages."""
    for pattern, page in LINKS:
        text = pattern.sub(page, text)
    return text


def front_page() -> str:
    """README.md, its links those of the site."""
    text = (ROOT / "README.md").read_text("utf-8")
    text = text.replace("](docs/", "](").replace(
        "](notebooks)", "](notebooks/quickstart.md)"
    )
    return to_pages(text)
