"""The notebooks as pages: their text, code and stored outputs."""

import base64
import json
from pathlib import Path
from typing import Any

from . import ROOT

NOTEBOOKS = ROOT / "notebooks"


def notebook_pages() -> dict[str, str | bytes]:
    """Markdown and pictures by path below the pages' folder."""
    found: dict[str, str | bytes] = {}
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        text, pictures = as_markdown(json.loads(path.read_text("utf-8")), path.stem)
        found[f"notebooks/{path.stem}.md"] = text
        found |= {f"notebooks/{name}": content for name, content in pictures.items()}
    return found


def as_markdown(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """A page, and the pictures that it shows by their file's name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(_to_pages(source))
        elif source.strip():
            parts.append(f"```python\n{source}\n```")
            for output in cell.get("outputs", ()):
                parts += _shown(output, name, pictures)
    return "\n\n".join(parts) + "\n", pictures


def _shown(output: dict[str, Any], name: str, pictures: dict[str, bytes]) -> list[str]:
    data = output.get("data", {})
    if "image/png" in data:
        file = f"{name}-{len(pictures) + 1}.png"
        pictures[file] = base64.b64decode("".join(data["image/png"]))
        return [f"![Figure {len(pictures)} of {name}]({file})"]
    text = "".join(output.get("text", data.get("text/plain", ""))).rstrip("\n")
    return [f"```text\n{text}\n```"] if text else []


def _to_pages(markdown: str) -> str:
    """Links that lead from `notebooks/` to `docs/` lead to the pages."""
    return markdown.replace("](../docs/", "](../")


def title(path: Path) -> str:
    """The first heading of a notebook."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return "".join(cells[0]["source"]).partition("\n")[0].removeprefix("# ")
