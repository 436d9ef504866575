"""Studies: the same bits however they are cut, interrupted, or spread over processes."""

import contextlib
import json
import logging
import os
import signal
import threading
import time
import types

import cloudpickle
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import studies

import aslo_jax as aslo
from aslo_jax.engines._runtime import kernel
from aslo_jax.metrics import RMSError
from aslo_jax.study import open_study
from aslo_jax.study._cluster import local_cluster
from aslo_jax.study._problem import BLOCK


def test_what_a_study_returns(whole):
    sizes = {"sample": 600, "observer": 2, "entry": 1, "time": 3}
    assert dict(whole.sizes) == sizes
    assert whole["rms"].dims == ("sample", "observer", "entry")
    assert whole["settled"].dims == ("sample", "observer")
    assert whole["error"].dims == ("sample", "time", "observer")
    assert whole["time"].values.tolist() == [0.0, 0.1, 0.2]
    assert whole["observer"].values.tolist() == ["ASLO", "Luenberger"]
    assert np.isinf(whole["settled"]).any()
    attributes = whole.attrs
    assert attributes["aslo_jax_study"] == 1
    assert attributes["seed"] == "3"
    assert attributes["engine"] == "fused"
    assert json.loads(attributes["versions"])["jax"] == jax.__version__
    assert "LowPass" in json.loads(attributes["configuration"])["experiment"]


def test_a_study_is_what_its_samples_are(whole):
    """One sample by hand: its parameters, and the noise of the study, sample and time."""
    k = 321
    rate, speed, noise = (
        float(whole[f"parameter_{name}"][k]) for name in ("rate", "speed", "noise")
    )
    assert -1.0 < speed < 1.0
    word = aslo.random.key(studies.SEED)
    part = jnp.stack(aslo.random.threefry(aslo.random.key(0), word[0], word[1]))
    key = aslo.random.fold(part, k)
    plant = aslo.plants.IntegratorChain(2)
    observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(rate))
    x, y = np.array([0.0, speed]), []
    for i in range(21):
        y.append(x[0] + noise * float(aslo.random.normal(key, i)))
        u, h = float(studies.signal(i * studies.INTERVAL)), studies.INTERVAL
        x = np.array([x[0] + h * x[1] + h * h / 2 * u, x[1] + h * u])
    t = np.arange(21) * studies.INTERVAL
    u = np.asarray(studies.signal(t))
    estimate = aslo.replay(observer, t, u, np.array(y)).value[:, 0]
    truth = speed + np.concatenate([[0.0], np.cumsum(studies.INTERVAL * u[:-1])])
    rms = np.sqrt(np.mean((np.asarray(estimate) - truth) ** 2))
    assert float(whole["rms"][k, 0, 0]) == pytest.approx(rms, rel=1e-9)
    error = np.abs(np.asarray(estimate) - truth)[[0, 10, 20]]
    np.testing.assert_allclose(whole["error"][k, :, 0], error, rtol=1e-9)


def test_chunks_and_threads_change_no_bits(whole, stored):
    found = open_study(stored)
    assert found.attrs["chunk"] == BLOCK
    studies.assert_same(whole, found)


def test_scan_runs_in_blocks():
    """A sample has the same bits in a batch of one block, of several, and at the end."""
    samples = jnp.linspace(1.0, 9.0, 2 * 16 + 5)

    def make(rate):
        e = studies.experiment()
        inner = aslo.AlgebraicObserver(e.plant.relation(), aslo.LowPass(rate))
        observer = aslo.Asymptotic(inner, rate, initial=jnp.ones(1))  # which errs
        return aslo.Experiment(e.plant, e.controller, {"ASLO": observer}, 0.01)

    runner = aslo.Runner(
        make, samples[0], 20, metrics={"rms": RMSError("ASLO")}, engine="scan", block=16
    )
    assert runner.engine == "scan"
    assert runner.shapes.metrics["rms"].shape == (1,)
    all_of_them = np.asarray(runner(samples).metrics["rms"])
    assert all_of_them.shape == (37, 1)
    for first, last in ((0, 16), (16, 37), (32, 37)):
        piece = np.asarray(runner(samples[first:last]).metrics["rms"])
        np.testing.assert_array_equal(piece, all_of_them[first:last])
    fused = aslo.Runner(
        make, samples[0], 20, metrics={"rms": RMSError("ASLO")}, engine="fused"
    )
    np.testing.assert_allclose(fused(samples).metrics["rms"], all_of_them, rtol=1e-9)


def test_a_study_is_compiled_when_it_runs(monkeypatch):
    """Not where it is traced only, as by the client of a cluster; and once for all chunks,
    also where it was sent to."""
    compiled, compile_it = [], kernel.compiled
    monkeypatch.setattr(
        kernel,
        "compiled",
        lambda text, *more: compiled.append(text) or compile_it(text, *more),
    )
    study = studies.study_of(samples=3 * BLOCK)
    sent = cloudpickle.loads(cloudpickle.dumps(study))
    assert not compiled
    chunks = [sent.chunk(k) for k in range(3)]
    kernels = len(compiled)
    assert 1 <= kernels <= 3  # the loop, and its timetable
    assert study.chunk(1)["rms"].tobytes() == chunks[1]["rms"].tobytes()
    assert len(compiled) == 2 * kernels


# ---- interrupted ---------------------------------------------------------------------


# ---- refused -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(samples=0), "`samples` must be a whole number from 1, but got 0"),
        (
            dict(key=4),
            "`key` must be a key of .* but got 4, which is a seed",
        ),
        (dict(key=jax.random.split(jax.random.key(0))), "`key` must be one key"),
        (dict(key=jax.random.key(0, impl="rbg")), 'of the generator "threefry2x32"'),
        (dict(every=7), "`every` must divide the number of steps, 20, but got 7"),
        (dict(horizon=1.0), "One of the arguments `steps` and `horizon`"),
        (dict(steps=None, horizon=0.015), "whole number of the experiment's intervals"),
        (dict(chunk=0), "`chunk` must be a whole number from 1"),
    ],
)
def test_refused_arguments(changes, message):
    with pytest.raises(ValueError, match=message):
        studies.run_study(**changes)


# ---- on several processes ------------------------------------------------------------


@pytest.mark.slow
def test_worker_killed(tmp_path):
    """Two workers of a real cluster, one killed once the first chunks are done; the bits
    are those of one process, in a store and in memory."""
    many = dict(samples=20 * BLOCK, steps=1000, every=500, chunk=BLOCK)
    path = tmp_path / "run.zarr"
    killed = []
    with local_cluster(2) as client:
        workers = client.run(os.getpid)

        def kill():
            while len(list(path.glob("internal/done/c/*"))) < 2:
                time.sleep(0.005)
            killed.append(len(list(path.glob("internal/done/c/*"))))
            os.kill(next(iter(workers.values())), signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        found = studies.run_study(store=path, client=client, **many)
        killer.join()
        assert killed[0] < 20
        alone = studies.run_study(**many)
        studies.assert_same(alone, found)


def test_the_end_of_a_cluster_is_not_warned_of(monkeypatch, capfd):
    """What Dask says while it closes, as of a worker that ends late, is no news."""
    logger = logging.getLogger("distributed.nanny")
    handler, level = logging.StreamHandler(), logger.level
    monkeypatch.setattr(logger, "handlers", [handler])

    class Cluster(contextlib.AbstractContextManager):
        def __init__(self, **given):
            assert given["n_workers"] == 3

        def __exit__(self, *_):
            logger.warning("Worker process still alive after 4.0 seconds, killing")

    class Client(Cluster):
        def __init__(self, cluster):
            assert isinstance(cluster, Cluster)

        def __exit__(self, *_):
            logger.warning("a worker was lost")

    dask = types.SimpleNamespace(LocalCluster=Cluster, Client=Client)
    monkeypatch.setattr("aslo_jax.study._cluster.require", lambda *_: dask)
    with pytest.raises(KeyError), local_cluster(3):
        raise KeyError
    assert capfd.readouterr().err == "a worker was lost\n"
    assert logger.level == level


def test_a_sample_does_not_depend_on_how_many_there_are(whole):
    again = studies.run_study(samples=1)
    assert float(again["parameter_rate"][0]) == float(whole["parameter_rate"][0])
    np.testing.assert_array_equal(again["rms"][0], whole["rms"][0])
