"""The figure of every kind of machine: its panels, and what is drawn in them."""

import held_logs
import matplotlib.figure
import numpy as np
import pytest

from aslo_jax.cli import main
from aslo_jax.logs import write_table
from aslo_jax.machines import template

MOTOR = ["Flux, start of the log", "Flux, end of the log", "error", "Speed", "Certificate"]
PANELS = {
    "stepper": MOTOR,
    "wrim": [
        "Stator flux, start of the log",
        "Stator flux, end of the log",
        "Rotor flux, start of the log",
        "Rotor flux, end of the log",
        "error",
        "Certificate",
    ],
    "magnetic_bearing": ["error", "Flux", "Position", "Velocity", "Certificate"],
}
LOGS = {
    "stepper": lambda: held_logs.motor(
        0.55, 1.5e-3, 1.5e-3, 0.0038, 50, 300.0, 2.0, rows=1001
    ),
    "wrim": lambda: held_logs.wrim(False, rows=1001),
    "magnetic_bearing": lambda: held_logs.bearing(rows=1001),
}


def draw(monkeypatch, folder, *options) -> matplotlib.figure.Figure:
    """The figure that a command saves; the file is written too."""
    figures = []
    save = matplotlib.figure.Figure.savefig

    def spy(self, *arguments, **settings):
        figures.append(self)
        save(self, *arguments, **settings)

    monkeypatch.setattr(matplotlib.figure.Figure, "savefig", spy)
    out, plot = folder / "out.npz", folder / "out.png"
    arguments = ["estimate", folder / "log.npz", "--machine", folder / "machine.toml"]
    arguments += ["--out", out, "--plot", plot, "-q", *options]
    with pytest.raises(SystemExit):
        main([str(argument) for argument in arguments])
    assert plot.read_bytes().startswith(b"\x89PNG")
    (figure,) = figures
    return figure


@pytest.mark.parametrize("kind", PANELS)
def test_panels_show_estimates_over_the_truth(tmp_path, monkeypatch, kind):
    log = LOGS[kind]()
    write_table(tmp_path / "log.npz", log)
    (tmp_path / "machine.toml").write_text(template(kind))
    axes = draw(monkeypatch, tmp_path).axes
    assert len(axes) == len(PANELS[kind])
    with np.load(tmp_path / "out.npz") as table:
        for axis, title in zip(axes, PANELS[kind], strict=True):
            assert title in axis.get_title()
            drawn = {line.get_label(): line for line in axis.get_lines()}
            if title == "error":
                names = [name for name in drawn if name.endswith("flux")]
                assert len(names) == (2 if kind == "wrim" else 1)
                continue
            for name in set(drawn) & set(table):
                t, values = drawn[name].get_data()
                rows = np.isin(table["t"], t)
                if not name.startswith("certificate"):
                    np.testing.assert_array_equal(values, table[name][rows])
                    assert "truth" in drawn
            if "of the log" in title:
                first, last = axis.get_xlim()
                edge = log["t"][0] if "start" in title else log["t"][-1]
                assert edge in (first, last)
    if kind != "wrim":
        return
    without = draw(monkeypatch, tmp_path, "--no-truth").axes
    titles = [axis.get_title() for axis in without]
    assert any(title.startswith("Consistency without truth, | ") for title in titles)
    for axis in without:
        assert "truth" not in {line.get_label() for line in axis.get_lines()}
