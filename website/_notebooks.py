"""The notebooks as pages: their text, code and stored outputs."""

import base64
import importlib
import json
from pathlib import Path
from typing import Any

from . import ROOT
from ._pictures import small

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


def run(path: Path) -> Any:
    """A notebook with the outputs of running it here."""
    nbformat = importlib.import_module("nbformat")
    client = importlib.import_module("nbclient").NotebookClient
    notebook = nbformat.read(path, as_version=4)
    client(
        notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}
    ).execute()
    return notebook


def record(names: list[str]) -> None:
    """Run the notebooks with these names, by default all, and store what they show."""
    nbformat = importlib.import_module("nbformat")
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        if names and path.stem not in names:
            continue
        notebook = run(path)
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)  # when it ran
            for output in cell.get("outputs", ()):
                _made_small(output)
        nbformat.write(notebook, path)
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


def _made_small(output: Any) -> None:
    """Pictures of few colours, and no HTML beside a text."""
    data = output.get("data", {})
    if "text/html" in data and "text/plain" in data:
        del data["text/html"]
    if "image/png" in data:
        picture = small(base64.b64decode(data["image/png"]))
        data["image/png"] = base64.b64encode(picture).decode() + "\n"


def texts(notebook: Any) -> list[str]:
    """What a notebook prints, output by output."""
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", ()):
            text = output.get("text", output.get("data", {}).get("text/plain", ""))
            found.append("".join(text))
    return found
