"""The gallery, the notebooks and the pages that are made by running: fresh, and with the
numbers that they show."""

import json
import re
from pathlib import Path

import pytest

pytest.importorskip("PIL", reason="of matplotlib")

from aslo_jax import paper
from website import _commands, _errata, _gallery, _notebooks

ROOT = Path(__file__).parents[1]
STORED = _gallery.stored_headlines()
QUICK = {"exact_start"}
CASES = [
    pytest.param(script, marks=[] if script.stem in QUICK else [pytest.mark.slow])
    for script in _gallery.scripts()
]


@pytest.mark.parametrize("script", CASES, ids=lambda script: script.stem)
def test_a_script_gives_its_picture_and_its_number(script, monkeypatch):
    monkeypatch.chdir(ROOT)
    found, stored = _gallery.run(script), STORED[script.stem]
    # Two per cent: other versions of JAX and other processors round otherwise.
    assert found.value == pytest.approx(stored["value"], rel=0.02)
    assert (found.quantity, found.unit) == (stored["quantity"], stored["unit"])
    assert found.name == stored["picture"]
    # White paper alone takes 1 kB.
    assert len(found.picture) > 5_000


def test_every_script_has_a_place_and_a_picture_of_its_code():
    folder = ROOT / "docs" / "gallery"
    names = {script.stem for script in _gallery.scripts()}
    assert names == {path.stem for path in folder.glob("*.py")} == set(STORED)
    assert len(names) >= 20
    for name, stored in STORED.items():
        assert stored["script"] == _gallery.digest(folder / f"{name}.py"), (
            f"docs/gallery/{name}.py has changed: python -m website gallery {name}"
        )
        assert (folder / stored["picture"]).stat().st_size < 250_000
    pictures = {path.name for kind in ("png", "gif") for path in folder.glob(f"*.{kind}")}
    assert pictures == {stored["picture"] for stored in STORED.values()}


def test_the_overview_of_the_gallery_is_fresh():
    text = (ROOT / "docs" / "gallery" / "README.md").read_text("utf-8")
    assert text == _gallery.overview(".py")


def test_the_page_of_the_command_line_has_the_options_of_the_program():
    text = _commands.PAGE.read_text("utf-8")
    lines = [line for some in _commands.RUN.values() for line in some]
    shown = re.findall(
        r"^```console\n\$ aslo-jax (.*)\n((?:.*\n)*?)```$", text, re.MULTILINE
    )
    assert sorted(line for line, _ in shown) == sorted(lines)
    assert _commands.written(dict(shown)) == text, "python -m website commands"


@pytest.mark.slow
def test_the_page_of_the_command_line_has_its_output():
    assert _commands.written() == _commands.PAGE.read_text("utf-8")


def test_errata_have_the_verdicts_that_the_experiments_are_held_to():
    text = _errata.PAGE.read_text("utf-8")
    tests = (ROOT / "tests" / "test_paper_section2.py").read_text("utf-8")
    (held,) = re.findall(r"\d+ claims: \d+ confirmed, \d+ corrected, 0 not", tests)
    pattern = r"^(\d+) claims: (\d+) confirmed, (\d+) corrected, 0 not reproduced"
    counts = re.findall(pattern, text, re.MULTILINE)
    assert len(counts) == len(paper.SECTIONS)
    assert held in text
    for claims, confirmed, corrected in counts:
        assert int(claims) == int(confirmed) + int(corrected)
    # A row for each that is corrected, beside two for the head of each table.
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(rows) - 2 * len(counts) == sum(int(count[2]) for count in counts)


def test_a_page_of_errata_from_a_table_of_claims(tmp_path):
    (tmp_path / "section_2").mkdir()
    (tmp_path / "section_2" / "claims.csv").write_text(
        "name,place,claim,quantity,measured,unit,as_claimed,as_corrected,verdict,remark\n"
        "one,2.1,It is so.,what,0.12345,m,< 0.1,0.12 +- 0.01,corrected: not so|,\n"
        "two,2.2,It is.,what,0.5,m,< 1,,confirmed,\n"
    )
    page = _errata.written(tmp_path)
    assert "2 claims: 1 confirmed, 1 corrected, 0 not reproduced." in page
    row = "| 2.1 | It is so. | what: 0.123 m | < 0.1 | 0.12 +- 0.01 | not so\\| |"
    assert row in page and "Confirmed: two (2.2)." in page


def test_a_notebook_as_a_page():
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": ["one\n"]},
        {"output_type": "display_data", "data": {"image/png": "AAAA"}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "[a](../docs/tuning.md)"]},
        {"cell_type": "code", "source": ["print('one')"], "outputs": outputs},
    ]
    text, pictures = _notebooks.as_markdown({"cells": cells}, "name")
    assert text == (
        "# Title\n[a](../tuning.md)\n\n```python\nprint('one')\n```\n\n"
        "```text\none\n```\n\n![Figure 1 of name](name-1.png)\n"
    )
    assert pictures == {"name-1.png": b"\0\0\0"}


def test_notebooks_are_stored_with_outputs_and_are_small():
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert path.stat().st_size < 400_000
        cells = json.loads(path.read_text("utf-8"))["cells"]
        ran = [cell["execution_count"] for cell in cells if cell["cell_type"] == "code"]
        assert ran == list(range(1, len(ran) + 1)), (
            f"python -m website notebooks {path.stem}"
        )
