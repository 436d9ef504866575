"""The gains of a study's file, tuned: in Python, and by the command, in the same file."""

import copy
import re
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from typer.testing import CliRunner

from aslo_jax.cli import main
from aslo_jax.cli._app import app
from aslo_jax.cli._tune import compared
from aslo_jax.described import changed, tune_study
from aslo_jax.schema._toml_text import rewritten
from aslo_jax.study._config import NAMES

pytest.importorskip("llvmlite")
TEXT = (files("aslo_jax.study") / "configs" / "double_integrator.toml").read_text("utf-8")

GAINS = {"cutoff": 3.0, "gain": 2.0}  # rad/s, far from the best
# Errors count from when all have been certified: until then the loss jumps with the gain.
SETTINGS = dict(samples=16, seed=3, after=0.4)


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
    assert tuned.rms_after < tuned.rms_before
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


def test_gains_that_fit_their_samples_only_are_told():
    assert compared(0.2, 0.1) == "2 times less"
    assert "no less: more --samples" in compared(0.1, 0.101)


def test_the_command_writes_the_same_file_with_its_gains(tmp_path, tuned):
    text = TEXT
    content = tomllib.loads(text)
    path, out = tmp_path / "study.toml", tmp_path / "tuned.toml"
    text = text.replace(f"horizon = {content['horizon']}", "horizon = 1.0")
    path.write_text(rewritten(text, {"observers.A-ASLO": GAINS}))
    command = ["tune", str(path), "--out", str(out), "--plot", str(tmp_path / "tuned.png")]
    command += ["--gain", "A-ASLO.cutoff", "--samples", "16"]
    command += ["--seed", "3", "--iterations", "20", "--after", "0.4"]
    found = CliRunner().invoke(app, command)
    assert found.exit_code == 0, found.output
    assert "A-ASLO: cutoff" in found.output and "times less" in found.output
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
