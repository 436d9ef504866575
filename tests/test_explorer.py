"""The explorer without a browser: its states, its loops, its server, its files."""

import base64
import csv
import dataclasses
import http.client
import io
import json
import threading
import tomllib
from urllib.parse import urlencode

import numpy as np
import pytest
from test_cli import LOG, MOTOR, read_csv, refusal, run

from aslo_jax.cli._explorer import (
    _exports as exports,
    _knobs as knobs,
    _programs as programs,
    _server,
)
from aslo_jax.cli._explorer._newest import Newest, StaleError
from aslo_jax.cli._explorer._panels import Result
from aslo_jax.cli._explorer._recorded import FILE, Recorded
from aslo_jax.cli._explorer._results import Results
from aslo_jax.cli._explorer._scene import PRINTED, ready
from aslo_jax.cli._explorer._session import Session
from aslo_jax.cli._explorer._state import State, StateError
from aslo_jax.logs import LogReader
from aslo_jax.machines import read_machine
from aslo_jax.study._config import configure


@pytest.fixture(scope="module")
def session():
    return Session()


@pytest.fixture(scope="module")
def server(session):
    found = _server.Server(0, lambda: session)
    thread = threading.Thread(target=found.serve_forever, daemon=True)
    thread.start()
    yield found
    found.shutdown()
    thread.join()
    found.server_close()


def ask(server, target, method="GET", **headers):
    """Status, headers and body of a request."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=120)
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, target, skip_host="Host" in names)
    for name, value in names.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def drawing(found) -> list[str]:
    """Everything that is drawn of a run."""
    return [line["values"] for panel in found["panels"] for line in panel["lines"]]


# States.


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


# Loops.


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
    lanes = programs.band_lanes(layout, source.scene.tolerances, 0, 1.0)
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


# Files.


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
    code, *_ = run(capsys, *saved(session, state, "ASLO"), "--outliers", "keep")
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
    code, *_ = run(capsys, *saved(session, moved, "ASLO"), "--outliers", "keep")
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


# A log of one's own.


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


# Results of a study.


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


# Requests.


def test_only_the_loopback_is_listened_to(server):
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("target", sorted(_server.PAGE))
def test_the_page_is_served(server, target):
    status, headers, body = ask(server, target)
    assert status == 200
    assert len(body) > 500
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    own = body.replace(b"http://www.w3.org/2000/svg", b"").replace(b"url(#", b"")
    for outside in (b"http://", b"https://", b"url(", b"@import"):
        assert outside not in own


@pytest.mark.parametrize(
    "target",
    [
        "/../_server.py",
        "/%2e%2e/_server.py",
        "/page/../../_server.py",
        "//etc/passwd",
        "/index.html/../../_state.py",
        "/style.css%00",
        "/_server.py",
        "/api/",
        "/api/run/../export",
    ],
)
def test_no_path_leads_anywhere_else(server, target):
    status, _, body = ask(server, target)
    assert status == 404
    assert json.loads(body) == {"error": "There is nothing here."}


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD"])
def test_only_get_is_answered(server, method):
    status, headers, _ = ask(server, "/api/about", method)
    assert status == 405
    assert headers["Allow"] == "GET"


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_another_name_or_site_is_refused(server, headers):
    port = server.server_port
    given = {name: value.format(port=port) for name, value in headers.items()}
    status, _, body = ask(server, "/api/about", **given)
    assert status == 403
    assert "own" in json.loads(body)["error"]


def test_its_own_names_are_answered(server):
    port = server.server_port
    for name in ("127.0.0.1", "localhost"):
        own = {"Host": f"{name}:{port}", "Origin": f"http://{name}:{port}"}
        status, _, body = ask(server, "/api/about", Sec_Fetch_Site="same-origin", **own)
        assert status == 200
        assert json.loads(body)["title"] == "PMSM under speed control"


def test_a_wrong_state_is_told_in_one_line(server):
    status, _, body = ask(server, "/api/run?observers.ASLO.cutoff=0")
    assert status == 400
    assert "must be from 2.38 to 23800 rad/s, but is 0." in json.loads(body)["error"]
    assert ask(server, f"/api/run?{'a' * 7000}")[0] == 414
    assert ask(server, "/api/run?n=x")[0] == 400


def test_a_request_that_a_newer_one_made_needless_is_dropped(server):
    query = urlencode({"horizon": 0.1, "client": "page", "n": 5})
    status, _, body = ask(server, f"/api/run?{query}")
    assert status == 200
    assert json.loads(body)["n"] == 5
    query = urlencode({"horizon": 0.1, "client": "page", "n": 4})
    assert ask(server, f"/api/run?{query}")[::2] == (409, b'{"stale":true}')
    other = urlencode({"horizon": 0.1, "client": "another page", "n": 1})
    assert ask(server, f"/api/run?{other}")[0] == 200


def test_requests_that_wait_give_way_to_the_newest():
    newest, done, held = Newest(), [], threading.Event()
    begun = threading.Event()

    def first():
        with newest.turn("page", "run", 1):
            begun.set()
            held.wait(60)
            done.append(1)

    def later(number):
        try:
            with newest.turn("page", "run", number):
                done.append(number)
        except StaleError:
            done.append(-number)

    threads = [threading.Thread(target=first)]
    threads[0].start()
    begun.wait(60)
    for number in (2, 3):
        threads.append(threading.Thread(target=later, args=(number,)))
        threads[-1].start()
        while newest._newest["page", "run"] != number:
            pass
    held.set()
    for thread in threads:
        thread.join()
    assert sorted(done) == [-2, 1, 3]


# Knobs.


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


# The command.


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--machine", MOTOR), "--machine is for a LOG; name one."),
        ((LOG,), "with --machine, a TOML file"),
        (("nothing.csv", "--machine", MOTOR), "nothing.csv does not exist."),
        ((MOTOR.parent, "--machine", MOTOR), "is a directory"),
        ((MOTOR.parent,), "is not a study of aslo_jax"),
    ],
)
def test_what_cannot_be_explored_is_refused(capsys, arguments, said):
    assert said in refusal(capsys, 2, "explore", "--no-browser", *arguments)
