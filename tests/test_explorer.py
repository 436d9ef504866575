"""The explorer's states, knobs and loops."""

import tomllib

import numpy as np
import pytest
from explorers import drawing, unpacked
from test_cli import LOG, MOTOR, refusal

from aslo_jax._studies import ready_made
from aslo_jax.cli._explorer import (
    _exports as exports,
    _knobs as knobs,
    _programs as programs,
)
from aslo_jax.cli._explorer._scene import PRINTED, ready, scene_of
from aslo_jax.cli._explorer._session import Session
from aslo_jax.cli._explorer._state import State, StateError
from aslo_jax.study._config import configure


@pytest.fixture(scope="module")
def session():
    return Session()


def test_a_state_is_that_of_its_address():
    values = {"observers.ASLO, slow.cutoff": 1.0 / 3.0, "a.b": 1e-300, "c.d": "paper"}
    state = State("pmsm", ("ASLO", "Ü & =?"), 0.4, 7, 0.1, values)
    assert State.of_query(state.query(), "wrim") == state
    assert State.of_query("", "wrim") == State("wrim")
    assert State("pmsm").query() == "source=pmsm"
    assert State.of_query("n=3&client=x&a.b=2", "pmsm") == State(
        "pmsm", values={"a.b": 2.0}
    )


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("a.b=nan", "`a.b` must be a finite number, but is 'nan'."),
        ("a.b=-inf", "`a.b` must be a finite number, but is '-inf'."),
        ("a.b=1e999", "`a.b` must be a finite number"),
        ("a.b=<script>", "`a.b` must be a finite number"),
        ("a.b=1&a.b=2", "A query must give `a.b` once."),
        ("path=/etc/passwd", "`source`, `observer`, `horizon`, `seed`, `tolerance`"),
        ("seed=-1", "`seed` must be a whole number"),
        ("seed=99999999999", "`seed` must be from 0 to 2147483647"),
        ("tolerance=4", "`tolerance` must be from 0 to 3, but is 4."),
        ("horizon=0", "`horizon` must be positive (s), but is 0."),
        ("observer=A&observer=A", "`observer` must name every observer once."),
        ("x" * 6001, "at most 6000 characters"),
        ("a.b=%ff", "must be UTF-8"),
    ],
)
def test_an_address_that_is_no_state_is_refused(query, said):
    with pytest.raises(StateError) as refused:
        State.of_query(query, "pmsm")
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("source=motor", "`source` must be one of pmsm, wrim"),
        ("source=log", "No log was opened"),
        ("source=study", "No study was opened"),
        ("observer=FO9", "`observer` must be one of ASLO, A-ASLO"),
        ("horizon=1e6", "`horizon` must be from 0.01 to 4 s, but is 1e+06."),
        ("observers.FO1.gain=1", "There is no knob `observers.FO1.gain` here."),
        ("observers.ASLO.cutoff=1e9", "must be from 2.38 to 23800 rad/s, but is 1e+09."),
        ("observers.ASLO.start=late", "must be one of exact, paper, but is 'late'."),
        ("error.resistance=big", "`error.resistance` must be a number"),
    ],
)
def test_what_no_source_has_is_refused(session, query, said):
    with pytest.raises(StateError) as refused:
        session.run(State.of_query(query, "pmsm"))
    assert said in str(refused.value)


def test_every_default_is_within_its_limits():
    for name in ("pmsm", "wrim", "magnetic_bearing", "robotic_leg", "ball_beam"):
        scene = ready(name)
        every = tuple(scene.content["observers"])
        found = scene.knobs(State(name, every))
        assert len({knob.key for knob in found}) == len(found) > 15
        for knob in found:
            assert knob.checked(knob.default) == knob.default
            assert knob.group
            assert knob.label
        assert knobs.settings(found, {}) == {knob.key: knob.default for knob in found}


@pytest.mark.slow
def test_no_slider_compiles_and_every_one_changes_what_is_drawn(session):
    plain = State("pmsm", horizon=0.1)
    first = session.run(plain)
    session.band(plain)
    traced = session.programs.traced
    assert traced > 0
    source = session.source(plain)
    for knob in source.scene.knobs(plain):
        if knob.options:
            continue
        share = 0.3 if knob.default != knob.low + 0.3 * (knob.high - knob.low) else 0.6
        value = knob.low + share * (knob.high - knob.low)
        other = session.run(State("pmsm", horizon=0.1, values={knob.key: value}))
        assert drawing(other) != drawing(first), knob.key
        session.band(State("pmsm", horizon=0.1, values={knob.key: value}))
    session.run(State("pmsm", horizon=0.1, seed=3))
    session.band(State("pmsm", horizon=0.1, seed=3, tolerance=2.0))
    assert session.programs.traced == traced
    other = session.run(State("pmsm", horizon=0.1, seed=3))
    assert drawing(other) != drawing(first)
    assert drawing(session.run(plain)) == drawing(first)


def test_another_structure_compiles(session):
    plain = State("pmsm", horizon=0.1)
    session.run(plain)
    traced = session.programs.traced
    values = {f"observers.{PRINTED.format('ASLO')}.start": "exact"}
    found = session.run(State("pmsm", horizon=0.1, values=values))
    assert session.programs.traced > traced
    first, second = found["panels"][0]["lines"]
    assert first["values"] == second["values"]


def test_without_tolerances_and_noise_all_runs_are_the_one(session):
    quiet = {"noise.sensor": 0.0, "noise.input_sensor": 0.0, "error.resistance": 0.1}
    state = State("pmsm", horizon=0.1, tolerance=0.0, values=quiet)
    found, band = session.run(state), session.band(state)
    wide = session.band(State("pmsm", horizon=0.1))
    t, at = unpacked(found["t"]), unpacked(band["t"])
    rows = np.searchsorted(t, at - 1e-6)
    for line in found["panels"][0]["lines"]:
        of = band["bands"][line["observer"]]
        assert of["low"] == of["high"]
        np.testing.assert_allclose(
            unpacked(of["low"]), unpacked(line["values"])[rows], rtol=1e-5, atol=1e-8
        )
        of = wide["bands"][line["observer"]]
        assert (unpacked(of["low"]) < unpacked(of["high"])).all()


def test_a_plant_that_cannot_be_is_refused(session):
    values = {"error.mutual_inductance": 0.2}
    with pytest.raises(StateError, match=r"^This machine cannot be: .*mutual_inductance"):
        session.run(State("wrim", values=values))
    values = {"error.mutual_inductance": 0.13}
    with pytest.raises(StateError, match=r"^\d+ of 256 machines cannot be: "):
        session.band(State("wrim", values=values, tolerance=3.0))


def test_a_study_that_says_its_first_flux_and_noises_keeps_them():
    content = tomllib.loads(ready_made("pmsm"))
    content["machine"]["initial"] = {"flux": [0.1, 0.1]}
    content["sensor"][0]["deviation"] = [0.01, 0.02]
    scene = scene_of(content)
    keys = {knob.key for knob in scene.knobs(State("study"))}
    assert not keys & {"machine.initial.angle", "noise.sensor"}
    moved = scene.moved(State("study", values={"error.magnet_flux": 0.1})).content
    assert moved["machine"]["initial"]["flux"] == [0.1, 0.1]
    assert moved["sensor"][0]["deviation"] == [0.01, 0.02]
    assert moved["machine"]["load"] == content["machine"]["load"]


def test_a_parameter_error_is_of_the_plant_and_not_of_the_description(session):
    source = session.source(State("pmsm"))
    values = {"error.resistance": 0.2, "error.magnet_flux": -0.1}
    state = State("pmsm", values=values)
    machine = source.described(state, "ASLO").machine
    assert machine.resistance == 8.875
    assert source.scene.moved(state).errors["resistance"] == 0.2
    layout = programs.layout_of(source.scene.moved(state), 0)
    true = dict(zip(layout.paths, layout.leaves, strict=True))
    assert true["plant.resistance"] == pytest.approx(1.2 * 8.875)
    assert true["observers.ASLO.relation.resistance"] == 8.875
    # It starts without current, and so does each run of a band.
    lanes = programs.band_lanes(layout, source.scene.tolerances, 0, 1.0, True)
    numbers = [p for p, x in true.items() if programs.is_number(x)]
    every = dict(zip(numbers, lanes, strict=True))
    for leaves in (true, every):
        start = np.linalg.norm(leaves["initial.flux"], axis=-1)
        np.testing.assert_allclose(start, leaves["plant.magnet_flux"], rtol=1e-12)
    assert np.std(every["plant.magnet_flux"]) > 0.01 * 0.2086
    assert np.ptp(every["observers.ASLO.relation.resistance"]) == 0.0
    content = exports.study_content(source.scene.moved(state), 1.0)
    whole = configure(content)
    resistance = whole.spread.parameters["resistance"].distribution
    assert (resistance.low, resistance.high) == pytest.approx((1.08, 1.56))
    assert "speed" not in whole.spread.parameters
    narrow = configure(exports.study_content(source.scene.moved(state), 0.5))
    deviation = narrow.spread.parameters["magnet_flux"].distribution.deviation
    assert deviation == pytest.approx(0.5 * 0.9 * 0.03)
    none = configure(exports.study_content(source.scene.moved(state), 0.0))
    assert none.spread.parameters["error_resistance"].distribution.values == (1.2,)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--machine", MOTOR), "--machine is for a LOG; name one."),
        ((LOG,), "with --machine, a TOML file"),
        ((MOTOR,), "is a TOML file, which is no LOG"),
        (("nothing.csv", "--machine", MOTOR), "nothing.csv does not exist."),
        ((MOTOR.parent, "--machine", MOTOR), "is a directory"),
        ((MOTOR.parent,), "is not a study of aslo_jax"),
    ],
)
def test_what_cannot_be_explored_is_refused(capsys, arguments, said):
    assert said in refusal(capsys, 2, "explore", "--no-browser", *arguments)
