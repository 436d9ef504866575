"""The figure of every kind of machine: its panels, and what is drawn in them."""

import held_logs
import matplotlib.figure
import numpy as np
import pytest

from aslo_jax.cli import main
from aslo_jax.logs import write_table
from aslo_jax.machines import template

END = "End of the log"
MOTOR = [
    *("Inputs, start of the log", END, "Outputs, start of the log", END),
    *("Flux, start of the log", END, "Angle, start of the log", END),
    *("error", "Speed", "Certificate", "mechanical (rpm)"),
]
PANELS = {
    "stepper": MOTOR,
    "wrim": [
        *("Inputs, start of the log", END, "Outputs, start of the log", END),
        *("Stator flux, start of the log", END, "Rotor flux, start of the log", END),
        "error",
        "Certificate",
    ],
    "magnetic_bearing": [
        "Inputs",
        "Outputs",
        "error",
        "Flux",
        "Position",
        "Velocity",
        "Certificate",
    ],
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
    for axis in axes:  # a legend is beside its title
        if axis.get_legend() is not None and axis.get_title(loc="left"):
            legend = axis.get_legend().get_window_extent()
            assert axis._left_title.get_window_extent().x1 < legend.x0, axis
    shown = set()
    with np.load(tmp_path / "out.npz") as table:
        data = log | dict(table)
        for axis, title in zip(axes, PANELS[kind], strict=True):
            assert title in axis.get_title(loc="left") + axis.get_ylabel()
            drawn = {line.get_gid(): line for line in axis.get_lines()}
            truth = "truth" in {line.get_label() for line in axis.get_lines()}
            if title == "error":
                names = [name for name in drawn if name and name.endswith("flux")]
                assert len(names) == (2 if kind == "wrim" else 1)
                continue
            for name in set(drawn) & set(data):
                t, values = drawn[name].get_data()
                rows = np.isin(table["t"], t)
                expected = data[name][rows]
                shown.add(name)
                if name == "theta_electrical":
                    values, expected = (
                        np.radians(values),
                        np.where(
                            np.isnan(values),
                            np.nan,
                            (expected + np.pi) % (2 * np.pi) - np.pi,
                        ),
                    )
                    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-9)
                elif not name.startswith("certificate"):
                    np.testing.assert_array_equal(values, expected)
                if name in table and not name.startswith("certificate"):
                    assert truth
            if "of the log" in title:
                first, last = axis.get_xlim()
                edge = log["t"][0] if "start" in title else log["t"][-1]
                assert edge in (first, last)
    signals = [n for n in log if n != "t" and n[0] in "ui"]
    columns = [n for n in table.files if n[:5] in ("flux_", "theta", "omega", "veloc")]
    assert {*signals, *columns} <= shown
    if kind != "wrim":
        return
    without = draw(monkeypatch, tmp_path, "--no-truth").axes
    titles = [axis.get_title(loc="left") for axis in without]
    assert any(title.startswith("Consistency without truth, | ") for title in titles)
    for axis in without:
        assert "truth" not in {line.get_label() for line in axis.get_lines()}
