"""The verdict on logs: right ones pass in silence, wrong ones are told why."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from motor_logs import (
    MOTORS,
    Motor,
    as_log,
    dropped,
    instant,
    late,
    noisy,
    run,
    spiked,
    swapped,
    without,
)

from aslo_jax.cli import main
from aslo_jax.diagnosis import diagnose, retimed, retimed_pieces, shift_of
from aslo_jax.diagnosis._rows import suspect_rows
from aslo_jax.logs import Log

BY_NAME = {motor.name: motor for motor in MOTORS}
NOISE = 0.005  # of the rated current


def kinds(log, motor, **parameters) -> list[str]:
    """The kinds of the warnings on a log, for parameters that may be wrong."""
    found = diagnose(as_log(log), [motor.circle(**parameters)])
    return [warning.kind for warning in found.warnings]


def recorded(motor, profile="rich", seed=3, dead=0.0):
    return noisy(run(motor, profile, dead=dead), motor, seed, NOISE)


slow = lambda *values: [pytest.param(v, marks=pytest.mark.slow) for v in values]


@pytest.mark.parametrize(
    "profile", ["rich", "reversal", *slow("start", "constant", "steps")]
)
@pytest.mark.parametrize("name", ["servo", "interior", *slow("drone", "stepper")])
def test_right_logs_pass_in_silence(name, profile):
    motor = BY_NAME[name]
    clean = run(motor, profile)
    for noise in (0.0, 0.02):
        assert kinds(noisy(clean, motor, 1, noise, noise / 4), motor) == []


@pytest.mark.parametrize("name", ["servo", "crane", "salient"])
def test_likely_errors_of_parameters_pass_in_silence(name):
    motor = BY_NAME[name]
    log = recorded(motor)
    assert kinds(log, motor, R=1.01 * motor.R) == []
    assert kinds(log, motor, psi=1.08 * motor.psi) == []
    assert kinds(log, motor, Ld=1.04 * motor.Ld, Lq=1.04 * motor.Lq) == []


def test_nothing_is_said_of_a_machine_at_rest():
    motor = BY_NAME["servo"]
    found = diagnose(as_log(recorded(motor, "standstill")), [motor.circle(R=1.2 * motor.R)])
    assert found.warnings == ()
    assert "too little turning" in found.notes[0]


ANYWHERE = {
    "sign": lambda x, motor: x | {"i": -x["i"]},
    "current_unit": lambda x, motor: x | {"i": 1e3 * x["i"]},
    "voltage_unit": lambda x, motor: x | {"u": 1e3 * x["u"]},
    "voltage_scale": lambda x, motor: x | {"u": x["u"] / 31},
    "beta_flipped": lambda x, motor: x | {"i": x["i"].conj()},
    "axes_swapped": lambda x, motor: x | {"u": 1j * x["u"].conj()},
    "offset": lambda x, motor: x | {"i": x["i"] - 0.08j * motor.current},
    "voltage_timing": lambda x, motor: x | {"u": late(x["u"], 2)},
    "outliers": lambda x, motor: spiked(x, 1234, 10 * motor.current),
    "lost_rows": lambda x, motor: without(x, slice(1500, 1530)),
    "missing_rows": lambda x, motor: dropped(x, 1),
}
OF_THREE_PHASES = {
    "phases_a_b": lambda x, motor: x | {"u": swapped(x["u"]), "i": swapped(x["i"])},
    "power_invariant": lambda x, motor: x | {"u": 1.5**0.5 * x["u"]},
}


@pytest.mark.parametrize("kind", ANYWHERE)
@pytest.mark.parametrize("name", ["stepper", *slow("servo", "small")])
def test_the_cause_of_a_wrong_log_is_named(name, kind):
    motor = BY_NAME[name]
    assert kinds(ANYWHERE[kind](recorded(motor), motor), motor) == [kind]


@pytest.mark.parametrize("kind", OF_THREE_PHASES)
@pytest.mark.parametrize("name", ["salient", *slow("drone", "crane")])
def test_frames_of_three_phases_are_named(name, kind):
    motor = BY_NAME[name]
    assert kinds(OF_THREE_PHASES[kind](recorded(motor), motor), motor) == [kind]


@pytest.mark.parametrize("name", ["salient", *slow("servo", "small")])
def test_dead_time_is_named_with_its_volts(name):
    motor = BY_NAME[name]
    volts = 0.04 * float(np.sqrt(np.mean(np.abs(run(motor, "rich", 401)["u"]) ** 2)))
    log = as_log(recorded(motor, dead=volts))
    (warning,) = diagnose(log, [motor.circle()]).warnings
    assert warning.kind == "dead_time"
    told = float(warning.message.split("of which ")[1].split(" V")[0])
    np.testing.assert_allclose(told, volts, rtol=0.1)


def test_wrong_parameters_are_named_with_the_right_ones():
    motor = BY_NAME["servo"]
    log = as_log(recorded(motor))
    (warning,) = diagnose(log, [motor.circle(R=1.5 * motor.R)]).warnings
    assert warning.kind == "resistance"
    told = float(warning.message.split("resistance is ")[1].split(" ohm")[0])
    np.testing.assert_allclose(told, motor.R, rtol=0.02)
    for factor, kind in ((2.0, "line_to_line"), (3.0, "line_to_line")):
        L = factor * motor.Lq
        assert kinds(recorded(motor), motor, R=factor * motor.R, Ld=L, Lq=L) == [kind]
    assert kinds(recorded(motor), motor, Ld=8.0, Lq=8.0) == ["inductance_unit"]


def test_rows_are_those_of_the_log():
    motor = BY_NAME["servo"]
    circles = [motor.circle()]
    (spike,) = diagnose(as_log(spiked(recorded(motor), 1234, 9.0)), circles).warnings
    assert spike.rows == (1234,)
    assert "row 1234" in spike.message
    cut = without(without(recorded(motor), slice(2600, 2607)), slice(1500, 1520))
    (lost,) = diagnose(as_log(cut), circles).warnings
    assert lost.rows == (1499, 2579)


@pytest.mark.parametrize("h", [0.4, 1.0, 1.9])
@pytest.mark.parametrize("rows", [1, 2])
def test_outliers_are_none_of_lost_rows_where_a_row_is_as_long_as_the_winding(rows, h):
    """What a current that is off takes off the flux by R is as much as what it links; `h`
    (of the time constant of the winding) between rows."""
    motor = Motor(
        "arm", "pmsm", 5.1, 1.3e-3, 1.3e-3, 0.013, 6, 150.0, 0.9, h * 1.3e-3 / 5.1
    )
    log = noisy(run(motor, "constant", 1501), motor, 4, NOISE)
    for k in range(rows):
        log = spiked(log, 800 + k, 8.0 * motor.current)
    found = suspect_rows(as_log(log), motor.circle(), motor.dt)
    assert found.outliers.tolist() == [*range(800, 800 + rows)]
    assert found.lost.size == found.inputs.size == 0


def test_a_voltage_of_the_instant_is_named_and_mended():
    motor = dataclasses.replace(BY_NAME["servo"], dt=5e-4)
    log = as_log(instant(recorded(motor)))
    circles = [motor.circle()]
    before = diagnose(log, circles)
    assert [warning.kind for warning in before.warnings] == ["voltage_instant"]
    mended = diagnose(retimed(log, shift_of("instant")), circles)
    assert mended.warnings == ()
    assert mended.figures["residual"] < 0.2 * before.figures["residual"]


@pytest.mark.parametrize("voltage", ["instant", "delayed=2", "delayed=-1", "delayed=1.5"])
def test_inputs_are_moved_alike_in_pieces_and_whole(voltage):
    log = as_log(recorded(BY_NAME["servo"]))
    edges = [0, 3, 1000, 4000]
    rows = lambda a, b: Log(*(x[a : b + 1] for x in (log.t, log.u, log.y)), {})
    pieces = [rows(a, b) for a, b in itertools.pairwise(edges)]
    shift = shift_of(voltage)
    found = list(retimed_pieces(pieces, shift, [(0, 1)]))
    joined = np.concatenate([found[0].u, *(piece.u[1:] for piece in found[1:])])
    np.testing.assert_array_equal(joined, retimed(log, shift).u)


@pytest.mark.parametrize("voltage", ["later", "delayed=", "delayed=0.3", "delayed=99"])
def test_an_unknown_timing_is_refused(voltage):
    with pytest.raises(ValueError, match="must be held, instant or delayed=N"):
        shift_of(voltage)


@pytest.fixture
def command(tmp_path, capsys):
    """`aslo-jax estimate` on a log: its stderr, its JSON and its table."""
    motor = BY_NAME["servo"]
    machine = tmp_path / "motor.toml"
    machine.write_text(
        f'[machine]\nkind = "pmsm"\nresistance = {motor.R}\ninductance = {motor.Lq}\n'
        f"magnet_flux = {motor.psi}\npole_pairs = {motor.pole_pairs}\ninertia = 1e-4\n"
    )

    def estimate(log, *options):
        u, i = log["u"], log["i"]
        path, out, summary = (tmp_path / n for n in ("log.npz", "out.npz", "out.json"))
        columns = dict(u_alpha=u.real, u_beta=u.imag, i_alpha=i.real, i_beta=i.imag)
        np.savez(path, t=log["t"], **columns)
        paths = ["--machine", machine, "--out", out, "--json", summary]
        with pytest.raises(SystemExit) as left:
            main(["estimate", str(path), *map(str, paths), "-q", *options])
        assert not left.value.code
        with np.load(out) as table:
            columns = dict(table)
        return capsys.readouterr().err, json.loads(summary.read_text()), columns

    return estimate


def off(table, log) -> np.ndarray:
    flux = table["flux_alpha"] + 1j * table["flux_beta"]
    return np.abs(flux - log["flux"])[table["coasting"] == 0]


def test_estimate_warns_in_quiet_too_and_writes_json(command):
    log = recorded(BY_NAME["servo"])
    err, summary, table = command(log)
    assert (err, summary["warnings"]) == ("", [])
    assert summary["columns"] == list(table)
    assert summary["log"]["rows"] == log["t"].size
    err, summary, _ = command(log | {"i": -log["i"]})
    assert err.startswith("aslo-jax: warning: the currents have the wrong sign")
    (warning,) = summary["warnings"]
    assert (warning["kind"], warning["rows"]) == ("sign", [])
    assert warning["message"] in err


def test_an_outlier_is_left_out_unless_it_is_kept(command):
    motor = BY_NAME["servo"]
    log = spiked(recorded(motor), 2000, 30 * motor.current)
    err, summary, table = command(log)
    assert summary["warnings"][0]["rows"] == [2000]
    assert table["coasting"][2000] == 1
    assert off(table, log)[300:].max() < 0.03 * motor.psi
    err, _, table = command(log, "--outliers", "keep")
    assert "row 2000" in err
    assert off(table, log)[300:].max() > 0.3 * motor.psi


def test_the_observer_starts_again_where_rows_are_lost(command):
    motor = BY_NAME["servo"]
    log = without(recorded(motor), slice(2000, 2030))
    err, _, table = command(log)
    assert "rows are lost after row 1999" in err
    assert table["coasting"][2000:2003].all()
    assert off(table, log)[300:].max() < 0.05 * motor.psi


def test_the_timing_of_the_voltage_is_an_option(command):
    motor = BY_NAME["servo"]
    log = recorded(motor)
    shifted = log | {"u": late(log["u"], 2)}
    err, _, table = command(shifted)
    assert "--voltage delayed=2" in err
    worse = off(table, log)[300:].max()
    err, _, table = command(shifted, "--voltage", "delayed=2")
    assert err == ""
    assert off(table, log)[300:].max() < 0.3 * worse
