"""The command that runs studies."""

import pytest

from aslo_jax.cli import main
from aslo_jax.study import open_study


def command(*arguments, code=0):
    with pytest.raises(SystemExit) as caught:
        main(["study", *map(str, arguments)])
    assert caught.value.code == code


def test_command(tmp_path, capsys):
    """It runs a ready-made study, goes on with it, and refuses to overwrite it."""
    out = tmp_path / "out"
    options = ("double_integrator", "--samples", 5, "--seed", 7, "--out", out)
    command(*options)
    said = capsys.readouterr()
    assert "5 samples of 1000 steps" in said.out
    assert "trajectory-steps per second" in said.out
    assert "rms (m/s), median:" in said.out
    assert "100%" in said.err
    assert "steps/s" in said.err
    found = open_study(out / "study.zarr")
    assert dict(found.sizes) == {"sample": 5, "observer": 4, "entry": 1, "time": 51}
    assert found["rms"].attrs["units"] == "m/s"
    mean = found["rms"].mean(("sample", "entry"))
    assert mean.sel(observer="Kalman") < mean.sel(observer="Luenberger")
    assert '"kind": "double_integrator"' in found.attrs["configuration"]
    page = (out / "report.html").read_text("utf-8")
    assert "<h1>Double integrator: speed from position" in page
    assert page.count("Cramér-Rao bound</td>") == 1  # a line of the table of rms errors
    figures = {path.name for path in out.glob("*.png")}
    assert figures == {"metrics.png", "error.png", "parameters.png"}
    command(*options, code=2)
    assert "exists; go on with it" in capsys.readouterr().err
    command(*options, "--resume", "--quiet", "--no-report")
    said = capsys.readouterr()
    assert said.out == said.err == ""


def test_refused_commands(tmp_path, capsys):
    command("nothing", "--samples", 5, "--out", tmp_path, code=2)
    assert "neither a file nor a ready-made study" in capsys.readouterr().err
    both = ("--workers", 1, "--cluster", "tcp://nowhere:1")
    command("pmsm", "--samples", 5, "--out", tmp_path / "out", *both, code=2)
    assert "--cluster and --workers exclude each other" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
