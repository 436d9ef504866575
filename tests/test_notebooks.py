"""The notebooks run from the first cell to the last, and draw what they promise."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


FIGURES = {"machines": 4, "mechanical": 5, "monte_carlo": 2, "quickstart": 2, "tuning": 3}


@pytest.mark.parametrize(("name", "figures"), FIGURES.items())
def test_notebook(name, figures):
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "saved with outputs"
    resources = {"metadata": {"path": str(NOTEBOOKS)}}
    NotebookClient(notebook, timeout=240, resources=resources).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    assert sum("image/png" in out.get("data", {}) for out in outputs) == figures
    assert not [out["text"] for out in outputs if out.get("name") == "stderr"]


def test_every_notebook_is_tested():
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == FIGURES.keys()
