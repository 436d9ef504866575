"""What the explorer takes in and gives out: logs, studies, files for elsewhere."""

import csv
import dataclasses
import io
import tomllib

import numpy as np
import pytest
from explorers import drawing, unpacked
from test_cli import LOG, MOTOR, read_csv, run

from aslo_jax.cli import _table as tables
from aslo_jax.cli._explorer._panels import Result
from aslo_jax.cli._explorer._recorded import FILE, Recorded
from aslo_jax.cli._explorer._results import Results
from aslo_jax.cli._explorer._scene import PRINTED
from aslo_jax.cli._explorer._session import Session
from aslo_jax.cli._explorer._state import State, StateError
from aslo_jax.logs import LogReader
from aslo_jax.machines import read_machine
from aslo_jax.study._config import configure


@pytest.fixture(scope="module")
def session():
    return Session()


@pytest.fixture
def saved(tmp_path):
    """Write exported files, and run the command that they name."""

    def write(session, state, name):
        for what in ("toml", "csv"):
            file = session.export(state, what, name)
            (tmp_path / file.name).write_bytes(file.content)
        toml = (tmp_path / "explored.toml").read_text()
        command = toml.splitlines()[1].removeprefix("# aslo-jax ").split()
        place = {"explored.csv", "explored.toml", "estimate.csv"}
        return [tmp_path / word if word in place else word for word in command]

    return write


def test_the_exported_files_give_the_same_estimate_on_the_command_line(
    session, saved, capsys, tmp_path
):
    values = {
        "observers.ASLO.cutoff": 123.4,
        "error.resistance": 0.1,
        "offset.sensor.1": 0.02,
        "dead_time.voltage": 1.0,
        "loop.pll_bandwidth": 150.0,
    }
    state = State("pmsm", horizon=0.1, seed=5, values=values)
    code, *_ = run(capsys, *saved(session, state, "ASLO"))
    assert code == 0
    told = read_csv(tmp_path / "estimate.csv")
    result = session.source(state).result(state)
    drawn = result.columns["ASLO"]
    for name in ("flux_alpha", "flux_beta", "theta_electrical", "omega_electrical"):
        size = np.abs(drawn[name]).max()
        np.testing.assert_allclose(told[name], drawn[name], rtol=0, atol=1e-9 * size)
    np.testing.assert_array_equal(told["coasting"], drawn["coasting"])
    estimates = session.export(state, "estimates", "ASLO").content.decode()
    rows = list(csv.reader(io.StringIO(estimates)))
    column = rows[0].index("flux_beta (ASLO printed start)")
    table = result.columns[PRINTED.format("ASLO")]
    assert float(rows[-1][column]) == table["flux_beta"][-1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wrim", "robotic_leg", "ball_beam"])
def test_so_do_those_of_other_machines_and_no_slider_compiles(
    kind, session, saved, capsys, tmp_path
):
    source = session.source(State(kind))
    horizon = 200 * source.scene.content["interval"]
    state = State(kind, ("ASLO",), horizon, seed=2)
    found = session.run(state)
    session.band(state)
    traced = session.programs.traced
    values = {}
    for knob in source.scene.knobs(state):
        if not knob.options:
            share = 0.45 if knob.scale != "log" else 0.6
            value = (
                knob.low * (knob.high / knob.low) ** share
                if knob.scale == "log"
                else (knob.low + share * (knob.high - knob.low))
            )
            values[knob.key] = value if knob.group != "Noise" else knob.default
    moved = State(kind, ("ASLO",), horizon, seed=2, values=values)
    assert drawing(session.run(moved)) != drawing(found)
    session.band(moved)
    assert session.programs.traced == traced
    code, *_ = run(capsys, *saved(session, moved, "ASLO"))
    assert code == 0
    told = read_csv(tmp_path / "estimate.csv")
    drawn = source.result(moved).columns["ASLO"]
    for name in set(drawn) - {"certificate", "coasting"}:
        size = np.abs(drawn[name]).max()
        np.testing.assert_allclose(told[name], drawn[name], rtol=0, atol=1e-8 * size)


@pytest.mark.slow
def test_a_magnetic_bearing_runs(session):
    state = State("magnetic_bearing", horizon=0.02)
    ids = [panel["id"] for panel in session.run(state)["panels"]]
    assert ids == [
        "error",
        "flux_1",
        "flux_2",
        "position",
        "velocity",
        "residual_flux",
        "certificate",
    ]
    traced = session.programs.traced
    session.run(
        State("magnetic_bearing", horizon=0.02, values={"observers.ASLO.cutoff": 5e3})
    )
    assert session.programs.traced == traced


def test_what_no_description_says_is_refused(session):
    state = State("pmsm", ("FO1",))
    with pytest.raises(StateError, match='cannot say an observer of the kind "fo1"'):
        session.source(state).described(state, "FO1")
    bearing = State("magnetic_bearing")
    with pytest.raises(StateError, match="cannot say `forgetting`"):
        session.source(bearing).described(bearing, "ASLO")
    with pytest.raises(StateError, match="There is no export 'exe'"):
        session.export(State("pmsm"), "exe", "ASLO")


def test_a_study_of_the_state_can_be_run_as_it_is(session):
    text = session.export(State("pmsm", ("FO1",)), "study", "").content.decode()
    whole = configure(tomllib.loads(text))
    assert list(whole.experiment.observers) == ["FO1"]
    assert whole.steps == 2000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "own.csv"
    path.write_text("\n".join(LOG.read_text().splitlines()[:801]) + "\n")
    machine = read_machine(MOTOR)
    return Session(Recorded(LogReader(path, machine.signals), machine, path.name))


def test_a_log_is_estimated_as_on_the_command_line(recorded, saved, capsys, tmp_path):
    values = {
        f"observers.{FILE}.cutoff": 77.0,
        "error.inductance": -0.1,
        "offset.input_sensor.0": 0.5,
    }
    state = State("log", (FILE, "A-ASLO"), values=values)
    code, *_ = run(capsys, *saved(recorded, state, FILE))
    assert code == 0
    told = read_csv(tmp_path / "estimate.csv")
    result = recorded.source(state).result(state)
    drawn = result.columns[FILE]
    for name in ("flux_alpha", "flux_beta", "theta_electrical", "omega_electrical"):
        size = np.abs(drawn[name]).max()
        np.testing.assert_allclose(told[name], drawn[name], rtol=0, atol=1e-9 * size)
    # As the machine's file has it, where nothing is moved.
    own, log = read_machine(MOTOR), recorded.recorded.log
    plain = tables.estimate_log(log, own, own.rates(log), 4)
    still = recorded.source(state).result(State("log")).columns[FILE]
    for name in plain:
        np.testing.assert_array_equal(still[name], plain[name])
    about = recorded.about(state)
    assert about["sources"][0] == {"id": "log", "title": "Log: own.csv"}
    assert [each["name"] for each in about["observers"] if each["shown"]] == [
        FILE,
        "A-ASLO",
    ]
    assert "study" not in about["exports"]


def test_the_band_of_a_log_is_of_parameters_that_are_taken_for_others(recorded):
    exact = recorded.band(State("log", tolerance=0.0))["bands"][FILE]
    assert exact["runs"] == 256
    assert exact["low"] == exact["high"]
    wide = recorded.band(State("log"))["bands"][FILE]
    assert unpacked(wide["high"])[-1] > 10.0 * unpacked(exact["high"])[-1]


def test_a_log_without_truth_has_a_band_and_no_error(recorded):
    machine, log = recorded.recorded.machine, recorded.recorded.log
    blind = dataclasses.replace(log, truth={})
    found = Result(
        blind, {FILE: recorded.recorded.result(State("log")).columns[FILE]}, machine
    )
    drawn = found.drawn()
    panels = {panel["id"]: panel for panel in drawn["panels"]}
    assert np.isnan(unpacked(panels["error"]["lines"][0]["values"])).all()
    assert "angle_error" not in panels
    assert drawn["table"][0].keys() == {"observer", "residual", "certified"}
    assert drawn["table"][0]["certified"] > 0.9


def test_the_results_of_a_study_are_drawn(stored, whole):
    session = Session(results=Results(stored))
    found = session.run(State(session.first))
    ids = [panel["id"] for panel in found["panels"]]
    assert sorted(ids) == ["coasting", "error", "rms", "scatter", "settled"]
    by_observer = {row["observer"]: row for row in found["table"]}
    sizes = np.linalg.norm(whole["rms"].sel(observer="ASLO").values, axis=-1)
    assert by_observer["ASLO"]["rms"]["worst"] == int(sizes.argmax())
    assert by_observer["ASLO"]["rms"]["median"] == pytest.approx(np.median(sizes), rel=1e-3)
    (line, _) = next(p for p in found["panels"] if p["id"] == "rms")["lines"]
    np.testing.assert_allclose(unpacked(line["values"])[-1], sizes.max(), rtol=1e-6)
    assert found["parameters"] == ["rate", "speed", "noise"]
    other = session.against("speed")["panels"][-1]["lines"][0]["x"]
    np.testing.assert_allclose(unpacked(other), whole["parameter_speed"], rtol=1e-6)
    with pytest.raises(StateError, match="`parameter` must be one of rate, speed, noise"):
        session.against("mass")
    with pytest.raises(StateError, match="cannot be run here: it was not made from a"):
        session.sample(0)
