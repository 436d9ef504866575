"""Studies in continuous time: their files, their bits, and what is refused."""

import copy
import tomllib
from typing import Any

import jax
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import study
from aslo_jax._studies import ready_made
from aslo_jax.cli import main
from aslo_jax.cli._explorer._scene import scene_of
from aslo_jax.described import tune_study
from aslo_jax.study._cluster import local_cluster
from aslo_jax.study._config import ConfigurationError, configure
from aslo_jax.study._problem import Study

pytest.importorskip("llvmlite")

FILE = """
title = "A cart that is pushed"
interval = 0.02
horizon = 0.4
time = "continuous"
rtol = 1e-7
atol = 1e-9
every = 5

[machine]
kind = "double_integrator"

[control]
kind = "open_loop"
signal = { kind = "wave", amplitude = 1.5, frequency = 3.0 }

[observers.ASLO]
kind = "aslo"
cutoff = 6.0

[observers.Luenberger]
kind = "luenberger"
gain = 4.0

[[sensor]]
kind = "noise"
deviation = 0.02

[spread.speed]
where = "initial.1"
distribution = "normal"
mean = 0.3
deviation = 1.0

[metrics.rms]
kind = "rms"
after = 0.1

[metrics.peak]
kind = "peak"
norm = true
"""
CONTENT = tomllib.loads(FILE)
GIVEN: dict[str, Any] = dict(samples=260, key=jax.random.key(4))


def changed(**keys):
    """The content of the file with other keys."""
    return copy.deepcopy(CONTENT) | keys


def ran(content, **settings):
    found = configure(content)
    given = GIVEN | found.settings | settings
    return study.run(found.experiment, found.spread, **given)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    store = tmp_path_factory.mktemp("study") / "whole.zarr"
    return ran(CONTENT, store=store, chunk=256, engine="fused")


def test_a_file_says_how_its_time_runs():
    found = configure(CONTENT)
    assert isinstance(found.experiment, aslo.ContinuousExperiment)
    assert (found.experiment.rtol, found.experiment.max_steps) == (1e-7, 100_000)
    assert found.steps == 20 and found.content["time"] == "continuous"
    sampled = {k: x for k, x in CONTENT.items() if k not in ("time", "rtol", "atol")}
    found = configure(sampled | {"time": "sampled"})
    assert isinstance(found.experiment, aslo.Experiment)
    assert not {"time", "rtol", "atol", "max_steps"} & set(found.content)


@pytest.mark.slow
def test_the_other_engine_finds_the_same(whole):
    other = ran(CONTENT, samples=3, engine="scan")
    for name in ("rms", "peak", "error"):
        ours = whole[name].values[:3]
        np.testing.assert_allclose(other[name].values, ours, rtol=1e-4, atol=1e-6)


def test_a_study_that_was_interrupted_goes_on_to_the_same_bits(whole, tmp_path):
    store, done, chunk = tmp_path / "cut.zarr", [], Study.chunk

    def cut(*args):
        if done:
            raise KeyboardInterrupt
        done.append(args)
        return chunk(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Study, "chunk", cut)
        with pytest.raises(KeyboardInterrupt):
            ran(CONTENT, store=store, chunk=256, engine="fused")
    resumed = ran(CONTENT, store=store, resume=True, engine="fused")
    for name in whole.data_vars:
        np.testing.assert_array_equal(resumed[name], whole[name])


@pytest.mark.slow
def test_chunks_and_threads_leave_the_bits(whole):
    other = ran(CONTENT, chunk=512, threads=1, engine="fused")
    for name in whole.data_vars:
        np.testing.assert_array_equal(other[name], whole[name])


@pytest.mark.slow
@pytest.mark.slow
def test_a_cluster_leaves_the_bits(whole):
    with local_cluster(1) as client:
        found = ran(CONTENT, chunk=256, client=client, engine="fused")
    np.testing.assert_array_equal(found["rms"], whole["rms"])


def test_observers_are_ranked(whole):
    errors = {
        name: whole["rms"].sel(observer=name).values[:, 0] for name in CONTENT["observers"]
    }
    places = study.ranking(errors)
    medians = {name: np.median(x) for name, x in errors.items()}
    assert [p.observer for p in places] == sorted(medians, key=medians.__getitem__)
    assert places[1].p < 0.05


@pytest.mark.slow
def test_a_sample_runs_again(whole):
    found = configure(CONTENT)
    same = {k: x for k, x in found.settings.items() if k in ("metrics", "steps")}
    again = study.rerun(
        found.experiment, found.spread, index=7, engine="fused", **GIVEN, **same
    )
    for name in ("ASLO", "Luenberger"):
        np.testing.assert_array_equal(
            again.metrics["rms"][name], whole["rms"].sel(observer=name)[7]
        )
    assert again.simulation.y.shape == (21,)


@pytest.mark.slow
def test_the_command_runs_it(tmp_path, capsys):
    path = tmp_path / "file.toml"
    path.write_text(FILE)
    out = str(tmp_path / "out")
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["study", str(path), "--samples", "5", "--out", out, "--no-report"])
    assert "ASLO" in capsys.readouterr().out


SENSORS = {
    "encoder": {"kind": "encoder", "bits": 12, "ranges": [2.0]},
    "quantisation": {"kind": "quantisation", "step": 0.1},
    "delay": {"kind": "delay", "delay": 1.5},
    "missing": {"kind": "missing", "probability": 0.1},
}


@pytest.mark.parametrize("kind", SENSORS)
def test_what_needs_samples_is_refused_by_its_key(kind):
    bias = {"kind": "bias", "offset": 0.0}
    with pytest.raises(ConfigurationError, match=rf"`sensor\.1\.kind`, .{kind}., is"):
        configure(changed(sensor=[bias, SENSORS[kind]]))


def test_keys_of_the_other_time_are_refused():
    with pytest.raises(ConfigurationError, match='`plant_steps` is for `time = "sampled"`'):
        configure(changed(plant_steps=2))
    with pytest.raises(ConfigurationError, match='`rtol` is for `time = "continuous"`'):
        configure(changed(time="sampled"))
    with pytest.raises(ConfigurationError, match=r"`time`.*sampled.*continuous"):
        configure(changed(time="discrete"))
    adaptive = {
        "kind": "adaptive",
        "output_deviation": 0.01,
        "input_deviation": 0.1,
        "parameters": ["resistance"],
        "deviations": [0.1],
    }
    motor: dict[str, Any] = tomllib.loads(ready_made("pmsm"))
    motor |= {"time": "continuous"}
    motor["observers"] = {"Adaptive": adaptive}
    with pytest.raises(ConfigurationError, match=r"`observers\.Adaptive\.kind`"):
        configure(motor)
    with pytest.raises(ConfigurationError, match='`time` must be "sampled" for gains'):
        tune_study(CONTENT)


def test_an_observer_of_samples_takes_those_of_the_interval():
    motor: dict[str, Any] = tomllib.loads(ready_made("pmsm")) | {"time": "continuous"}
    motor["observers"] = {"L": motor["observers"]["Lifted Kalman"]}
    observer: Any = configure(motor).experiment.observers["L"]
    assert observer.interval == motor["interval"]


def test_it_is_not_explored():
    with pytest.raises(ConfigurationError, match=r"must be .sampled. to be explored"):
        scene_of(CONTENT)


def test_there_is_no_bound():
    found = configure(CONTENT)
    with pytest.raises(ValueError, match="the bound is one of samples in time"):
        study.bound_of(
            found.experiment, found.spread, 20, key=jax.random.key(0), trajectories=2
        )
