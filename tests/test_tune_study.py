"""The gains of a study's file, tuned: in Python, and by the command, in the same file."""

import copy
import dataclasses
import json
import re
import tomllib
from importlib.resources import files

import numpy as np
import pytest
import scipy.stats
import tomlkit
from typer.testing import CliRunner

from aslo_jax.cli import main
from aslo_jax.cli._app import app
from aslo_jax.described import changed, compared, machine_of, tune_study
from aslo_jax.described._operated import _operated
from aslo_jax.logs import Log
from aslo_jax.schema._toml_text import rewritten
from aslo_jax.study._config import NAMES, read_configuration

pytest.importorskip("llvmlite")
TEXT = (files("aslo_jax.study") / "configs" / "double_integrator.toml").read_text("utf-8")

GAINS = {"cutoff": 3.0, "gain": 2.0}  # rad/s, far from the best
# Errors count from when all have been certified: until then the loss jumps with the gain.
SETTINGS = dict(samples=64, seed=3, after=0.4)


def small():
    """The double integrator with its A-ASLO alone, over a second."""
    content = tomllib.loads(TEXT)
    content["horizon"] = 1.0
    del content["every"]
    content["observers"] = {"A-ASLO": content["observers"]["A-ASLO"] | GAINS}
    return content


@pytest.fixture(scope="module")
def tuned():
    gains = ["A-ASLO.cutoff"]
    return tune_study(small(), gains, **SETTINGS, iterations=20)["A-ASLO"]


def test_tuned_gains_are_better_than_those_before(tuned):
    assert tuned.rms_after < tuned.rms_before and tuned.improved
    assert tuned.before == {"cutoff": 3.0} and tuned.fitted.stopped != "iteration limit"


@pytest.mark.slow
def test_tuned_gains_are_better_than_those_around_them(tuned):
    for factor in (0.9, 1.1):
        beside = {"cutoff": factor * tuned.after["cutoff"]}
        content = changed(small(), {"observers.A-ASLO": beside})
        found = tune_study(content, ["A-ASLO.cutoff"], **SETTINGS, iterations=1)
        assert found["A-ASLO"].fitted.initial_loss > tuned.fitted.loss


def test_a_gain_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match=r"one of A-ASLO\.cutoff, A-ASLO\.gain, but got"):
        tune_study(small(), ["A-ASLO.cutof"])


def test_only_the_values_change():
    """Comments and other keys stay, in tables, in arrays of tables, and where a key was
    absent."""
    text = (
        "a = 1.0\n[x]  # x\na = 2.0   # two\n[[y]]\na = 3.0\n[[y]]\nb = 1 # b\n"
        "a = [4.0, 5.0]\n"
    )
    new = rewritten(text, {"x": {"a": 2.5, "c": 7.0}, "y.1": {"a": [4.5, 5.5]}})
    assert new == (
        "a = 1.0\n[x]  # x\nc = 7.0\na = 2.5   # two\n[[y]]\na = 3.0\n[[y]]\nb = 1 # b\n"
        "a = [4.5, 5.5]\n"
    )
    with pytest.raises(ValueError, match="must stand on one line each"):
        rewritten("[x]\na = [\n 1.0]\n", {"x": {"a": [2.0]}})


def test_tables_may_be_written_in_any_way():
    """Inline, dotted, in an inline array, before another one's part; after a byte mark."""
    text = (
        "\ufeffm = {kind = 'a', r = 1.0} # m\ns = [{k = 1.0}, {k = 2.0}]\nz.q = 1.5 # z\n"
        "[x]\na = 1e3   # a\n[y]\nb = 1\n[x.'s t']\nc = 2\n"
    )
    values = {"m": {"r": 2.0}, "s.1": {"k": 4.0}, "z": {"q": 2.5}}
    values |= {"x": {"a": 7.0, "n": 1.0}, "x.s t": {"c": 3, "d": 4}}
    assert rewritten(text, values) == (
        "\ufeffm = {kind = 'a', r = 2.0} # m\ns = [{k = 1.0}, {k = 4.0}]\nz.q = 2.5  # z\n"
        "[x]\na = 7.0   # a\nn = 1.0\n[y]\nb = 1\n[x.'s t']\nd = 4\nc = 3\n"
    )
    for wrong in ("w", "s.2", "x.t"):
        with pytest.raises(ValueError, match=f"must have a table `{re.escape(wrong)}` for"):
            rewritten(text, {wrong: {"a": 1.0}})


@pytest.mark.parametrize("name", NAMES)
def test_every_ready_made_study_is_rewritten(name):
    """Also where an observer has a name in quotes."""
    text = files("aslo_jax.study.configs").joinpath(f"{name}.toml").read_text()
    content = tomllib.loads(text)
    values = {
        f"observers.{observer}": {
            key: 1.5 * value for key, value in table.items() if isinstance(value, float)
        }
        for observer, table in content["observers"].items()
    }
    new = rewritten(text, values)
    assert tomllib.loads(new) == changed(content, values)
    assert len(new.splitlines()) == len(text.splitlines())
    assert new.count("#") == text.count("#")


def test_an_improvement_is_more_than_chance_may_give():
    """Of the differences of the same samples, whose interval is Student's."""
    rng = np.random.default_rng(1)
    size, change = rng.lognormal(0.0, 2.0, 64), rng.normal(size=64)
    before = size + 1.0
    after = before - 0.1 + 0.05 * change  # 6 standard deviations of the mean, not of one
    (low, high), improved = compared(before, after)
    less = (before - after) / before.mean()
    expected = scipy.stats.ttest_rel(before, after).confidence_interval(0.95)
    np.testing.assert_allclose((low, high), np.array(expected) / before.mean())
    assert improved and low < less.mean() < high
    assert not compared(after, before)[1]
    # As much less on average, and by chance.
    assert not compared(before, before - 0.1 + 2.0 * (change - change.mean()))[1]
    assert not compared(before[:1], after[:1])[1]
    broken = np.where(np.arange(64) == 3, np.nan, after)
    assert not compared(before, broken)[1] and compared(broken, after)[1]


def test_gains_that_fit_their_samples_only_are_told_and_not_written(
    tmp_path, monkeypatch, capsys, tuned
):
    """The observer that improves has its gains written, the other keeps its own."""
    path, out, read = (tmp_path / n for n in ("study.toml", "new.toml", "found.json"))
    path.write_text(TEXT)
    values = dict(less=(0.6, 0.9), improved=True, after={"cutoff": 6.0})
    better = dataclasses.replace(tuned, **values)
    values = dict(less=(-0.1, 0.1), improved=False, after={"cutoff": 9.0})
    worse = dataclasses.replace(tuned, **values)
    found = {"ASLO": better, "A-ASLO": worse}
    monkeypatch.setattr("aslo_jax.described.tune_study", lambda *a, **k: found)
    with pytest.raises(SystemExit) as left:
        main(["tune", str(path), "--out", str(out), "--json", str(read)])
    told = capsys.readouterr()
    assert left.value.code == 0
    assert "their mean square is less (60 to 90 %, 95 % interval)" in told.out
    assert "aslo-jax: warning: A-ASLO: no improvement beyond chance" in told.err
    new, old = tomllib.loads(out.read_text()), tomllib.loads(TEXT)
    assert new["observers"]["ASLO"]["cutoff"] == 6.0
    assert new["observers"]["A-ASLO"] == old["observers"]["A-ASLO"]
    gains = json.loads(read.read_text())["gains"]
    assert gains["ASLO.cutoff"]["written"] and not gains["A-ASLO.cutoff"]["written"]
    assert gains["A-ASLO.cutoff"] | {"less": 0} == {
        "before": 3.0, "after": 9.0, "written": False, "less": 0,
    }  # fmt: skip


def test_the_command_writes_the_same_file_with_its_gains(tmp_path, tuned):
    text = TEXT
    content = tomllib.loads(text)
    path, out = tmp_path / "study.toml", tmp_path / "tuned.toml"
    text = text.replace(f"horizon = {content['horizon']}", "horizon = 1.0")
    path.write_text(rewritten(text, {"observers.A-ASLO": GAINS}))
    command = ["tune", str(path), "--out", str(out), "--plot", str(tmp_path / "tuned.png")]
    command += ["--gain", "A-ASLO.cutoff", "--samples", "64"]
    command += ["--seed", "3", "--iterations", "20", "--after", "0.4"]
    found = CliRunner().invoke(app, command)
    assert found.exit_code == 0, found.output
    assert "A-ASLO: cutoff" in found.output and "square is less" in found.output
    new, old = tomllib.loads(out.read_text()), tomllib.loads(path.read_text())
    gains = new["observers"]["A-ASLO"]
    for key, value in tuned.after.items():
        np.testing.assert_allclose(gains[key], value, rtol=1e-6)
    expected = copy.deepcopy(old)
    expected["observers"]["A-ASLO"] = gains
    assert new == expected
    assert (tmp_path / "tuned.png").stat().st_size > 5_000


def test_a_file_that_is_not_toml_is_refused_by_name(tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text("title =")
    with pytest.raises(SystemExit) as left:
        main(["tune", str(path), "--out", str(tmp_path / "new.toml")])
    assert left.value.code == 2
    assert f"{path} is not valid TOML: " in capsys.readouterr().err


def motor_study():
    """A motor whose load and speed are spread, beside what is not."""
    content = tomllib.loads(
        (files("aslo_jax.study") / "configs" / "pmsm.toml").read_text("utf-8")
    )
    content["spread"] = {k: content["spread"][k] for k in ("resistance", "speed", "load")}
    return content


def test_speed_and_load_come_from_a_log():
    """Of a motor that turns backwards, brakes, and accelerates: mirrored, so that the
    speed is positive. Its load is what its torque does not need to accelerate it."""
    t = 2e-4 * np.arange(4000)
    speed = -(60.0 + 10.0 * np.sin(12.5 * t) + 20.0 * t)
    angle = -(60.0 * t - 0.8 * (np.cos(12.5 * t) - 1.0) + 10.0 * t**2)
    q = np.stack([-np.sin(5 * angle), np.cos(5 * angle)], axis=1)
    d = np.stack([np.cos(5 * angle), np.sin(5 * angle)], axis=1)
    current = 0.4 * q
    flux = 40.03e-3 * current + 0.2086 * d
    columns = {"coasting": np.zeros(t.size), "theta_electrical": 5 * angle}
    columns |= {"flux_alpha": flux[:, 0], "flux_beta": flux[:, 1]}
    content = motor_study()
    machine = machine_of(content)
    run = machine.operation(columns, Log(t, np.zeros((t.size, 2)), current, {}))
    torque = 1.5 * 5 * 0.2086 * 0.4  # against the motion
    assert run["speed"] == pytest.approx(-np.mean(speed), rel=1e-3)
    assert run["swing"] == pytest.approx(np.sqrt(2) * np.std(speed), rel=0.05)
    gained = (speed[0] - speed[-1]) / t[-1]
    assert run["torque"] == pytest.approx(-torque - 60e-6 * gained, rel=1e-3)
    columns["coasting"][20:] = 1
    assert machine.operation(columns, Log(t, np.zeros((t.size, 2)), current, {})) == {}


def test_a_file_is_moved_to_speed_and_load():
    content = motor_study()
    values = _operated(content, {"speed": 60.0, "swing": 7.0, "torque": 1.006})
    new = tomllib.loads(rewritten(tomlkit.dumps(content), values))
    assert new["control"]["reference"] == {"offset": 60.0, "amplitude": 7.0, "frequency": 3}
    assert new["machine"]["load"] == {"offset": pytest.approx(1.0)}  # less friction
    assert new["spread"]["speed"]["median"] == 60.0
    load = new["spread"]["load"]
    assert (load["low"], load["high"]) == (pytest.approx(0.5), pytest.approx(2.5))
    assert new["spread"]["resistance"] == content["spread"]["resistance"]
    del content["machine"]["load"]
    values = _operated(content, {"speed": 60.0, "swing": 7.0, "torque": 1.006})
    new = tomllib.loads(rewritten(tomlkit.dumps(content), values))
    assert new["machine"]["load"] == {"offset": pytest.approx(1.0)}


@pytest.mark.slow
def test_a_ready_made_study_is_printed_and_tuned_by_its_name(capsys, tmp_path):
    def run(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(x) for x in arguments])
        return left.value.code, capsys.readouterr()

    for name in NAMES:
        code, told = run("sample", "--study", name)
        assert code == 0
        assert tomllib.loads(told.out)["title"] == read_configuration(name).title
    code, told = run("sample", "--study", "pmsn")
    assert code == 2 and "--study must be one of double_integrator, pmsm," in told.err
    code, told = run("sample", "--study", "pmsm", "--kind", "wrim")
    assert code == 2 and "exclude each other" in told.err
    out = tmp_path / "new.toml"
    code, told = run("tune", "double_integrator", "--out", out, "--gain", "A-ASLO.cutof")
    assert code == 2 and "one of ASLO.cutoff, A-ASLO.cutoff" in told.err
    code, told = run("tune", "double_integrater", "--out", out)
    assert code == 2 and "neither a file nor a ready-made study" in told.err
