"""The command `calibrate`: a file with the values that were found, and refusals."""

import re

import numpy as np
import pytest

from aslo_jax.cli import main
from aslo_jax.described import calibrate_machine, calibrated_text as rewritten
from aslo_jax.logs import read_log, write_table
from aslo_jax.machines import MachineError, read_machine

MACHINE = """\
# A motor.
[machine]
kind = "pmsm"
resistance = 9.3     # ohm
inductance = 38e-3   # H
magnet_flux = 0.212  # Wb
pole_pairs = 5
inertia = 60e-6

[observer]
cutoff = 150.0  # resistance = 3
"""


def run(arguments):
    with pytest.raises(SystemExit) as code:
        main([str(a) for a in arguments])
    return code.value.code


def test_round_trip(tmp_path, capsys):
    """The calibrated file keeps all else, and estimates better."""
    log = read_log("aslo_jax/data/pmsm_log.csv")
    rows = slice(None)
    noise = 5e-3 * np.random.default_rng(1).standard_normal(log.y.shape)
    columns = {"t": log.t[rows], "u_alpha": log.u[rows, 0], "u_beta": log.u[rows, 1]}
    columns |= {
        f"i_{n}": log.y[rows, k] + noise[:, k] for k, n in enumerate(("alpha", "beta"))
    }
    columns |= {n: log.truth[n][rows] for n in ("flux_alpha", "flux_beta")}
    data, before, after = (tmp_path / n for n in ("log.csv", "motor.toml", "new.toml"))
    write_table(data, columns)
    before.write_text(MACHINE)
    figure = tmp_path / "both.png"
    options = ["--machine", before, "--out", after, "--plot", figure]
    assert run(["calibrate", data, *options]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"resistance +9\.3 +8\.8\d+ +\+- ", printed)
    new, old = after.read_text(), before.read_text()
    assert [s.partition("#")[2] for s in new.splitlines()] == [
        s.partition("#")[2] for s in old.splitlines()
    ]
    machine = read_machine(after).machine
    assert machine.resistance == pytest.approx(8.875, rel=3e-3)
    assert machine.inductance == pytest.approx(40.03e-3, rel=3e-3)
    assert figure.stat().st_size > 10_000
    scores = []
    for path in (before, after):
        out = tmp_path / "estimate.csv"
        assert run(["estimate", data, "--machine", path, "--out", out]) == 0
        found = re.search(r"flux, .* median ([\d.e-]+)", capsys.readouterr().out)
        scores.append(float(found[1]))
    assert scores[1] < 0.1 * scores[0]


def test_values_are_replaced_in_place():
    values = {"resistance": 8.875, "inductance": 0.04}
    new = rewritten(MACHINE, values)
    assert "resistance = 8.875   # ohm" in new
    assert "inductance = 0.04    # H" in new
    assert "cutoff = 150.0  # resistance = 3" in new
    bearing = '[machine]\nkind = "magnetic_bearing"\nresistance = [2.0, 2.7] # two\n'
    assert "resistance = [2.5, 2.25]  # two" in rewritten(
        bearing, {"resistance": [2.5, 2.25]}
    )
    assert "damping = [1.0, 2.0]" in rewritten(
        "[machine]\nm1 = 1.0\n", {"damping": [1.0, 2.0]}
    )
    with pytest.raises(MachineError, match="must stand on one line each"):
        rewritten("[machine]\ndamping = [\n  1.0, 2.0]\n", {"damping": [3.0, 4.0]})


def test_refusals(tmp_path, capsys):
    path = tmp_path / "motor.toml"
    path.write_text(MACHINE)
    machine = read_machine(path)
    log = read_log("aslo_jax/data/pmsm_log.csv")
    with pytest.raises(MachineError, match="must name one of resistance, inductance, mag"):
        calibrate_machine(machine, log, ["inertia"])
    arguments = ["calibrate", "aslo_jax/data/pmsm_log.csv", "--machine", path]
    assert run([*arguments, "--out", tmp_path / "new.txt"]) == 2
    assert "--out must be a .toml file" in capsys.readouterr().err
    assert run([*arguments, "--out", path]) == 2
    assert "--out would overwrite the machine" in capsys.readouterr().err
    assert run([*arguments, "--out", tmp_path / "new.toml", "--resolution", "0"]) == 2
    assert "`--resolution` must be positive" in capsys.readouterr().err
