"""The command `calibrate`: a file with the values that were found, and refusals."""

import dataclasses
import json
import re
from typing import get_args

import jax.numpy as jnp
import numpy as np
import pytest
from calibrations import calibrated
from machine_records import motor_log

import aslo_jax as aslo
from aslo_jax._choices import RecordError
from aslo_jax.cli import main
from aslo_jax.cli._calibrated import as_json, turned
from aslo_jax.described import calibrate_machine, calibrated_text as rewritten
from aslo_jax.described._calibrated import _near
from aslo_jax.logs import read_log, write_table
from aslo_jax.machines import MachineError, read_machine
from aslo_jax.tune._calibration.imperfections import FITS

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


@pytest.mark.slow
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


NAMES = ("log.csv", "motor.toml", "new.toml", "found.json")


def written(path, t, u, y):
    names = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    write_table(path, {"t": t} | dict(zip(names, np.concatenate([u, y], 1).T, strict=True)))


def turning(rows=900, offset=0.0):
    """A run of the motor of `MACHINE`'s true parameters in closed form: torque, direct
    current and speed vary."""
    motor = aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, 60e-6)
    t, u, y = motor_log(
        motor, 120.0, lambda t: 0.8 * jnp.sin(31 * t),
        lambda t: 1 + 0.3 * jnp.sin(17 * t), 2e-4, rows, 1e-3,
    )  # fmt: skip
    return t, u, y + np.array([offset, 0.0])


AT_REST = {
    "two rows": lambda t, u, y: (t[:2], u[:2], y[:2]),
    "thirty rows": lambda t, u, y: (t[:30], u[:30], y[:30]),
    "locked": lambda t, u, y: (t, 8.875 + 0 * u, 1.0 + 0 * y),
}


@pytest.mark.parametrize("case", AT_REST)
def test_a_log_that_shows_nothing_says_what_estimate_says(case, tmp_path, capsys):
    """And changes nothing, with the same exit."""
    data, before, out, read = (
        tmp_path / n for n in ("l.csv", "m.toml", "n.toml", "j.json")
    )
    before.write_text(MACHINE)
    written(data, *AT_REST[case](*turning()))
    common = [data, "--machine", before, "--quiet"]
    assert run(["estimate", *common, "--out", tmp_path / "e.csv"]) == 0
    said = capsys.readouterr().err
    assert run(["calibrate", *common, "--out", out, "--json", read]) == 0
    told = capsys.readouterr().err
    assert told.startswith(said) and "No calibration: in " in told.removeprefix(said)
    assert ("no estimate is certified" in said) == (case != "thirty rows")
    assert out.read_text() == MACHINE
    content = json.loads(read.read_text())
    assert set(content["parameters"]) == {"resistance", "inductance", "magnet_flux"}
    for each in content["parameters"].values():
        assert each["value"] is None and not each["determined"] and not each["written"]
    assert content["warnings"][-1]["kind"] == "nothing_determined"


@pytest.mark.slow
def test_errors_to_be_fitted_stand_in_the_file_and_what_is_found_is_told(tmp_path, capsys):
    """An offset of the currents is found, is in no file, and is not said to be unchanged in
    one."""
    data, before, out, read = (
        tmp_path / n for n in ("l.csv", "m.toml", "n.toml", "j.json")
    )
    text = MACHINE + '\n[calibration]\nfit = ["offset"]  # A\n'
    before.write_text(text)
    written(data, *turning(offset=0.03))
    figure = tmp_path / "found.svg"
    options = ["--machine", before, "--out", out, "--json", read, "--plot", figure]
    assert run(["calibrate", data, *options]) == 0
    told = capsys.readouterr()
    assert "unchanged in" not in told.out
    assert re.search(r"errors of the record, which .* does not hold: output_off", told.out)
    assert re.search(r"output_offset\[0\] 0\.(029|030?)\d* A, output_offset\[1\]", told.out)
    assert "offset" not in told.err  # it is fitted, so that no verdict is needed
    content = json.loads(read.read_text())["parameters"]
    for name, true in (("resistance", 8.875), ("inductance", 40.03e-3)):
        assert content[name]["written"] and content[name]["determined"]
        assert content[name]["value"] == pytest.approx(true, rel=3e-3)
    assert content["output_offset[0]"]["value"] == pytest.approx(0.03, rel=0.05)
    assert not content["output_offset[0]"]["written"]
    assert out.read_text().endswith('[calibration]\nfit = ["offset"]  # A\n')
    drawn = figure.read_text()
    assert "output_offset[0]" in drawn and "electrical frequency" in drawn
    before.write_text(text.replace('"offset"', '"ofset"'))
    assert run(["calibrate", data, *options]) == 2
    assert "calibration.fit" in capsys.readouterr().err


def test_a_log_in_other_units_changes_nothing_and_is_named(tmp_path, capsys):
    data, before, out = (tmp_path / n for n in ("l.csv", "m.toml", "n.toml"))
    before.write_text(MACHINE)
    t, u, y = turning()
    written(data, t, u, 1e3 * y)
    assert run(["calibrate", data, "--machine", before, "--out", out, "--quiet"]) == 0
    told = capsys.readouterr().err
    assert "the currents are in mA, not in A" in told and "--fit" not in told
    assert out.read_text() == MACHINE


def test_voltages_that_are_scaled_are_told_beside_the_parameters_that_explain_them(
    tmp_path, capsys
):
    """Resistance, inductance and flux all 1.2247 times: the log cannot tell which it is."""
    data, before, out = (tmp_path / n for n in ("l.csv", "m.toml", "n.toml"))
    right = MACHINE.replace("9.3 ", "8.875 ").replace("38e-3", "40.03e-3")
    before.write_text(right.replace("0.212 ", "0.2086 "))
    t, u, y = turning()
    written(data, t, 1.5**0.5 * u, y)
    assert run(["calibrate", data, "--machine", before, "--out", out, "--quiet"]) == 0
    told = capsys.readouterr().err
    assert "warning: either the parameters are those found, or with those of the" in told
    assert "power-invariant frame" in told
    assert read_machine(out).constants()["resistance"] == pytest.approx(
        1.5**0.5 * 8.875, rel=5e-3
    )


def test_an_error_that_no_sign_mends_is_not_taken_for_a_sign():
    refusal = "No calibration: with the sign of all outputs turned"
    sign = {"kind": "sign", "message": "the currents have the wrong sign"}
    own = {"kind": "inconsistent", "message": "the log does not fit"}
    scale = {"kind": "current_scale", "message": "the currents are 31 times too large"}
    assert turned(refusal, [own, sign]) == refusal
    assert turned(refusal, []) == refusal
    assert turned(refusal, [scale, own]) == f"No calibration: {scale['message']}."


def test_values_far_from_those_of_the_file_are_not_trusted():
    of = dict(
        before={"resistance": 1.0, "inductance": 2.0},
        estimate={"resistance": 3.5, "inductance": 2.1},
        after={"resistance": 3.5, "inductance": 2.1},
        interval={"resistance": (3.4, 3.6), "inductance": (2.0, 2.2)},
        withdrawn="",
    )
    found = calibrated(**of)
    near = _near(found)
    assert "values of resistance more than 3 times off" in near.withdrawn
    assert not near.determined("resistance") and not near.determined("inductance")
    closer = dataclasses.replace(found, before={"resistance": 1.2, "inductance": 2.0})
    assert _near(closer) is closer


def test_the_errors_that_an_interval_allows_for_are_in_the_table_and_for_programs():
    allowed = {"resistance": ("delay", "dead_time"), "inductance": ()}
    names = ("resistance", "inductance")
    of = {"before": {"resistance": 2.1, "inductance": 4e-3}}
    for field in ("estimate", "after", "interval"):
        of[field] = {n: getattr(calibrated(), field)[n] for n in names}
    found = calibrated(allowed=allowed, **of)
    rows = {row[0]: row[3] for row in found.rows()}
    assert rows["resistance"].endswith("; allows for a delay of the inputs, a dead time")
    assert "dead time" not in rows["inductance"]
    content = json.loads(as_json(found, {}, []))["parameters"]
    assert content["resistance"]["allowed"] == ["delay", "dead_time"]
    assert content["inductance"]["allowed"] == []


def test_the_words_for_errors_of_a_record_are_those_of_files():
    assert {*get_args(RecordError)} | {"output_offset"} == {*FITS, "encoder_offset"}
