"""The paper's reports: verdicts, settling, tables, files, and what is refused."""

import csv
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from aslo_jax import paper
from aslo_jax.export._traced import precision
from aslo_jax.paper import _section3 as section3
from aslo_jax.paper._claims import Above, Below, Claim, Near, to_csv, to_markdown, to_text
from aslo_jax.paper._report import Table, files
from aslo_jax.paper._section3 import settling
from aslo_jax.paper._settled import settled, settled_text
from aslo_jax.plot._figure import Figure


def test_settling_peaks_and_final_errors_of_an_exponential():
    t = np.linspace(0.0, 4.0, 4001)
    error = 2.0 * np.exp(-3.0 * t)
    trace = settling.Trace("experiment", "observer", "flux", "Wb", t, error, 2.0, 1.0)
    assert trace.settled(0.05) == pytest.approx(math.log(20) / 3, abs=1e-3)
    assert trace.settled(1e-9) == math.inf
    assert trace.settled(1.5) == 0.0
    assert trace.peak(0.0) == 2.0
    assert trace.peak(0.5, 1.0) == pytest.approx(2 * math.exp(-1.5))
    assert trace.final == pytest.approx(2 * math.exp(-3 * 3.8))
    # What counts is when it last comes back, not when it is first below.
    bounced = trace._replace(error=np.where(np.abs(t - 2.0) < 0.1, 1.0, error))
    assert bounced.settled(0.05) == pytest.approx(2.1, abs=2e-3)
    row = settling._row(trace)
    assert row["settled_5_percent_s"] == "0.999"
    assert row["later_window_s"] == "1 to 4" and row["later_peak"] == "0.0996"
    assert settling._row(trace._replace(error=0 * t + 1))["settled_5_percent_s"] == "> 4"


def test_a_table_in_the_report():
    rows = [{"a": "1", "b": "x|y"}, {"a": "2", "b": "z, w"}]
    table = Table("settling", "A title", "What it is.", rows)
    assert list(csv.DictReader(table.csv().splitlines())) == rows
    assert table.markdown() == (
        "# A title\n\nWhat it is.\n\n| a | b |\n|---|---|\n| 1 | x\\|y |\n| 2 | z, w |\n"
    )
    claim = Claim("a claim", "3", "It is so.", "what", 1.0, "m", Below(2.0))
    content, _ = files("Title", "Notes.", [], [claim], [table])
    assert content["settling.csv"] == table.csv().encode()
    assert content["settling.md"] == table.markdown().encode()
    assert "[settling.md](settling.md), [settling.csv](settling.csv): What it is." in (
        content["index.md"].decode()
    )


def test_run_dispatches_to_the_section(tmp_path, monkeypatch, capsys):
    reported = SimpleNamespace(report=lambda: ({"a.md": b"content"}, "summary"))
    monkeypatch.setattr(section3, "SECTION", reported)
    paper.run(3, tmp_path)
    assert (tmp_path / "a.md").read_bytes() == b"content"
    assert [path.name for path in tmp_path.iterdir()] == ["a.md"]
    assert capsys.readouterr().out == "summary\n"


def test_all_sections_have_an_index(tmp_path, monkeypatch, capsys):
    report = lambda: ({"a.md": b"content"}, "a table\n2 claims: 2 confirmed.")
    monkeypatch.setattr(paper, "_experiments", lambda section: report)
    paper.run("all", tmp_path)
    for section in paper.SECTIONS:
        assert (tmp_path / f"section_{section}" / "a.md").read_bytes() == b"content"
    assert (tmp_path / "index.md").read_text().splitlines()[2] == (
        "- [Section 2](section_2/index.md): 2 claims: 2 confirmed. "
        "[Claims](section_2/claims.md)"
    )
    assert capsys.readouterr().out.count("a table") == 3


def test_figures_are_written_as_pdf_with_letters_of_type_42():
    def draw(figure):
        figure.subplots().set(xlabel="time (s)")

    figure = Figure("one", "What it is.", {"t_s": np.zeros(2)}, draw, (3.0, 2.0))
    claim = Claim("a claim", "3", "It is so.", "what", 1.0, "m", Below(2.0))
    content, _ = files("Title", "Notes.", [figure], [claim])
    assert b"/CIDFontType2" in content["one.pdf"] and b"/Type3" not in content["one.pdf"]
    assert content["one.png"] == figure.png()
    assert b"[one.pdf](one.pdf)" in content["index.md"]


def claim(measured, printed, corrected=None):
    return Claim(
        "a name", "2.2", "It is so.", "what", measured, "m", printed, corrected, "not so"
    )


def test_a_verdict_follows_from_the_measurement():
    assert claim(0.5, Below(1.0), Near(2, 0.1)).verdict == "confirmed"
    assert claim(2.05, Below(1.0), Near(2, 0.1)).verdict == "corrected: not so"
    assert claim(3.0, Below(1.0), Near(2, 0.1)).verdict == "not reproduced"
    assert claim(3.0, Above(1.0)).verdict == "confirmed"
    assert claim(0.5, Above(1.0)).verdict == "not reproduced"
    assert claim(math.nan, Below(1.0), Above(0.0)).verdict == "not reproduced"


def test_the_tables_hold_what_was_measured():
    claims = [claim(2.0, Below(1.0), Near(2, 0.1)), claim(0.5, Below(1.0))]
    rows = list(csv.DictReader(to_csv(claims).splitlines()))
    assert [row["verdict"] for row in rows] == ["corrected: not so", "confirmed"]
    assert rows[0]["measured"] == "2"
    assert rows[0]["as_corrected"] == "2 +- 0.1"
    page = to_markdown(claims, "A title")
    assert page.startswith(
        "# A title\n\n2 claims: 1 confirmed, 1 corrected, 0 not reproduced."
    )
    assert "| a name | 2.2 | what | 2 m | < 1 | 2 +- 0.1 | corrected |" in page
    assert to_text(claims).splitlines()[1].split() == (
        ["a", "name", "2", "m", "<", "1", "corrected:", "not", "so"]
    )


def test_run_refuses_what_it_cannot_do(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"Argument `section` must be one of \(2"):
        paper.run(7, tmp_path)
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ValueError, match=r"Argument `out` must be a folder, but .* file"):
        paper.run(2, file)
    assert file.read_text() == "mine"
    with precision(np.float32), pytest.raises(ValueError, match="single precision"):
        paper.run(2, tmp_path / "out")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'pip install "aslo_jax\[plot\]"'):
        paper.run(2, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_settled_is_the_first_instant_after_the_last_above():
    t = np.array([0.1, 0.2, 0.3, 0.4])
    for error, time, text in (
        ([5.0, 0, -5, 0], 0.4, "0.4"),
        ([0.0, 0, 1, 0], 0.0, "0"),
        ([0.0, 0, 0, -5], math.inf, "> 0.4"),
    ):
        assert settled(t, np.array(error), 1.0) == time
        assert settled_text(t, np.array(error), 1.0) == text
