"""The notebooks run from the first cell to the last, and draw what they promise."""

import ast
import copy
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


FIGURES = {"machines": 4, "mechanical": 5, "monte_carlo": 2, "quickstart": 2, "tuning": 3}


def slow(name):
    return () if name == "quickstart" else pytest.mark.slow


CASES = [pytest.param(*case, marks=slow(case[0])) for case in FIGURES.items()]


NUMBER = re.compile(r"[-+]?\d+(\.\d*)?(e[-+]?\d+)?|\binf\b|\bnan\b")


def words_of(notebook):
    """What each cell prints, number by number as signs, since the last digits are the
    machine's; neither warnings nor how a table in a notebook is drawn. A kernel sends what
    one cell prints in as many messages as it likes."""
    texts = [
        "".join(
            out["text"] for out in cell.get("outputs", []) if out.get("name") == "stdout"
        )
        for cell in notebook.cells
    ]
    return [NUMBER.sub("#", text).split() for text in texts]


def pictures_of(notebook):
    """How many pictures each cell shows."""
    return [
        sum("image/png" in out.get("data", {}) for out in cell.get("outputs", []))
        for cell in notebook.cells
    ]


@pytest.mark.parametrize(("name", "figures"), CASES)
def test_notebook(name, figures):
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    stored = copy.deepcopy(notebook)
    resources = {"metadata": {"path": str(NOTEBOOKS)}}
    NotebookClient(notebook, timeout=240, resources=resources).execute()
    assert pictures_of(notebook) == pictures_of(stored), "python -m website notebooks"
    assert words_of(notebook) == words_of(stored), "python -m website notebooks"
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    assert sum("image/png" in out.get("data", {}) for out in outputs) == figures
    assert not [out["text"] for out in outputs if out.get("name") == "stderr"]


@pytest.mark.parametrize("name", FIGURES)
def test_what_a_notebook_imports_and_names_is_there(name):
    """Every import of its cells, and every name of the library in them."""
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    tree = ast.parse("\n".join(cells))
    imports = [n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom)]
    namespace = {}
    exec(compile(ast.Module(imports, []), name, "exec"), namespace)
    written = [ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
    used = {text for text in written if re.fullmatch(r"aslo(\.\w+)+", text)}
    assert used
    for each in used:
        eval(each, dict(namespace))


def test_every_notebook_is_tested():
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == FIGURES.keys()
