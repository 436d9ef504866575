"""Studies: the same bits however they are cut, interrupted, or spread over processes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import cloudpickle
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import studies
import xarray

import aslo_jax as aslo
from aslo_jax.engines._runtime import kernel
from aslo_jax.metrics import RMSError
from aslo_jax.study import open_study, run
from aslo_jax.study._cluster import local_cluster
from aslo_jax.study._lock import locked
from aslo_jax.study._problem import BLOCK, Problem, Study
from aslo_jax.study._store import open_store, verify
from aslo_jax.study._verification import own_checksum

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def whole():
    """In one piece, in memory."""
    return studies.run_study()


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Chunk by chunk, by one thread, in a store."""
    path = tmp_path_factory.mktemp("study") / "run.zarr"
    studies.run_study(store=path, chunk=1, threads=1)
    return path


@pytest.fixture(scope="module")
def schema():
    """That of the store: a study is traced once for the tests that need no more."""
    return study_of().schema


def study_of(**changes) -> Study:
    settings = studies.settings(**changes)
    seed = aslo.random.seed_of(settings.pop("key"))
    problem = Problem(
        studies.experiment(),
        studies.SPREAD,
        engine="auto",
        chunk=BLOCK,
        scale=None,
        configuration=None,
        units={},
        entries=None,
        seed=seed,
        **settings,
    )
    return Study(problem)


def copied(stored, tmp_path):
    return Path(shutil.copytree(stored, tmp_path / "run.zarr"))


def assert_same(a: xarray.Dataset, b: xarray.Dataset) -> None:
    """Bit for bit, NaN and infinity included."""
    assert set(a.data_vars) == set(b.data_vars)
    for name in (*a.data_vars, *a.coords):
        assert a[name].dims == b[name].dims
        assert a[name].attrs == b[name].attrs
        x, y = a[name].values, b[name].values
        assert x.dtype == y.dtype
        assert x.tobytes() == y.tobytes(), name


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
    assert_same(whole, found)


def test_scan_runs_in_blocks():
    """A sample has the same bits in a batch of one block, of several, and at the end."""
    samples = jnp.linspace(1.0, 9.0, 2 * 16 + 5)

    def make(rate):
        e = studies.experiment()
        observer = aslo.AlgebraicObserver(e.plant.relation(), aslo.LowPass(rate))
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
    study = study_of(samples=3 * BLOCK)
    sent = cloudpickle.loads(cloudpickle.dumps(study))
    assert not compiled
    chunks = [sent.chunk(k) for k in range(3)]
    kernels = len(compiled)
    assert 1 <= kernels <= 3  # the loop, and its timetable
    assert study.chunk(1)["rms"].tobytes() == chunks[1]["rms"].tobytes()
    assert len(compiled) == 2 * kernels


# ---- interrupted ---------------------------------------------------------------------

KILLED = """
import os, signal, sys, jax
jax.config.update("jax_enable_x64", True)
import zarr
from studies import run_study

count, write = 0, zarr.Array.__setitem__

def counted(array, place, value):
    global count
    count += array.ndim > 0 and array.shape[0] == 600 or array.path == "done"
    if count == {count}:
        os.kill(os.getpid(), signal.SIGKILL)
    write(array, place, value)

zarr.Array.__setitem__ = counted
run_study(store=sys.argv[1], chunk=256)
"""


def test_killed_while_it_writes(whole, tmp_path):
    """SIGKILL within the second of three chunks, some of its variables written."""
    path = tmp_path / "run.zarr"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", KILLED.format(count=13), str(path)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    half = xarray.open_zarr(path, consolidated=False)
    assert (half["done"].values != 0).tolist() == [True, False, False]
    assert np.isfinite(half["parameter_rate"][:256]).all()
    assert np.isnan(half["parameter_rate"][512:]).all()
    resumed = studies.run_study(store=path, resume=True)
    assert_same(whole, resumed)


def test_half_written_and_left_over_files(whole, stored, tmp_path):
    """A chunk without its mark is computed again, whatever its files hold."""
    path = copied(stored, tmp_path)
    (path / "done" / "c" / "1").unlink()
    (path / "rms" / "c" / "1" / "0" / "0").write_bytes(b"half")
    left = path / "rms" / "c" / "1" / "0" / "0.1234.partial"
    left.write_bytes(b"of a write")
    beside = tmp_path / ".run.zarr.partial"
    beside.mkdir()
    assert_same(whole, studies.run_study(store=path, resume=True))
    assert not left.exists()


def test_killed_while_the_store_is_made(whole, tmp_path):
    beside = tmp_path / ".run.zarr.partial"
    beside.mkdir()
    (beside / "zarr.json").write_text("{")
    path = tmp_path / "run.zarr"
    assert_same(whole, studies.run_study(store=path, resume=True))
    assert not beside.exists()


# ---- refused -------------------------------------------------------------------------


def snapshot(path: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}


def refused(path: Path, message: str, **changes) -> None:
    """With a clear error, and every file as it was."""
    before = snapshot(path)
    with pytest.raises(ValueError, match=message):
        studies.run_study(store=path, **({"resume": True} | changes))
    assert snapshot(path) == before


def test_existing_store_is_refused(stored):
    refused(stored, "exists; go on with it by `resume=True`", resume=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(key=jax.random.key(4)), "another `seed`.*it was 3, now it is 4"),
        (dict(samples=700), "another `samples`.*it was 600, now it is 700"),
        (dict(metrics={"rms": RMSError}), "another `configuration`.*`metrics.settled` was"),
        (dict(chunk=512), "another `chunk`"),
    ],
)
def test_store_of_other_settings_is_refused(stored, changes, message):
    refused(stored, message, **changes)


def test_store_of_other_parameters_is_refused(stored):
    experiment = studies.experiment()
    noise = experiment.sensor.deviation * (1 + 1e-15)
    changed = jax.tree.map(lambda x: x, experiment)
    object.__setattr__(changed.sensor, "deviation", noise)
    before = snapshot(stored)
    with pytest.raises(ValueError, match=r"another `(configuration|fingerprint)`"):
        run(changed, studies.SPREAD, **studies.settings(store=stored, resume=True))
    assert snapshot(stored) == before


def _flip(path):
    file = path / "error" / "c" / "2" / "0" / "0"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(bytes(data))


def _versions(path):
    file = path / "zarr.json"
    content = json.loads(file.read_text())
    content["attributes"]["versions"] = json.dumps({"jax": "0.0.1"})
    content["attributes"]["checksum"] = own_checksum(content["attributes"])
    file.write_text(json.dumps(content))


def _foreign(path):
    file = path / "zarr.json"
    file.write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_flip, "damaged study: chunk 2"),
        (lambda p: (p / "rms/c/0/0/0").unlink(), "damaged study: chunk 0 is not what was"),
        (
            lambda p: (p / "rms/zarr.json").unlink(),
            "damaged study: file rms/zarr.json is not",
        ),
        (lambda p: (p / "zarr.json").write_text("{"), "its zarr.json cannot be read"),
        (lambda p: (p / "zarr.json").unlink(), "not a study of aslo_jax"),
        (_foreign, "Zarr group, but not a study of aslo_jax"),
        (_versions, "another `versions`.*`jax` was 0.0.1"),
    ],
)
def test_damaged_and_foreign_stores_are_refused(stored, tmp_path, schema, damage, message):
    path = copied(stored, tmp_path)
    assert open_store(path, schema, resume=True).done().all()
    damage(path)
    before = snapshot(path)
    with pytest.raises(ValueError, match=message):
        open_store(path, schema, resume=True)
    assert snapshot(path) == before


def test_a_damaged_store_is_refused_by_a_study(stored, tmp_path):
    path = copied(stored, tmp_path)
    _flip(path)
    refused(path, "damaged study: chunk 2")


def _undo(path: Path, whole: dict[Path, bytes]) -> None:
    for file, data in whole.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


HARMS = ("flipped", "cut", "zeros", "gone")


@pytest.mark.parametrize(
    "shift", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))]
)
def test_damage_to_any_file_is_told_and_repaired(stored, tmp_path, schema, shift):
    """Every file of a store in turn, in one way each, all four ways with all shifts. No
    chunk that was whole is run again."""
    path, full = copied(stored, tmp_path), ("done", *schema.order)
    whole = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    assert verify(path) == ((), (), ())
    for k, (file, data) in enumerate(sorted(whole.items())):
        half, harm = len(data) // 2, HARMS[(k + shift) % len(HARMS)]
        if harm == "gone":
            file.unlink()
        else:
            flipped = data[:half] + bytes([data[half] ^ 16]) + data[half + 1 :]
            new = {"flipped": flipped, "cut": data[:half], "zeros": bytes(len(data))}
            file.write_bytes(new[harm])
        name = file.relative_to(path).as_posix()
        part = name.split("/")
        if name == "zarr.json":  # what study it is is not known any more
            for ask in (verify, open_study):
                with pytest.raises(ValueError, match=r"damaged study|not a study"):
                    ask(path)
        elif part[0] == "done" and part[1] == "c" and harm == "gone":
            assert verify(path).missing == (int(part[2]),)
        else:
            found, samples = verify(path), part[1] == "c" and part[0] in full
            assert found, name
            assert found.chunks == ((int(part[2]),) if samples else ()), name
            assert found.files == (() if samples else (name,)), name
            with pytest.raises(ValueError, match=r"damaged study: .* not what was written"):
                open_store(path, schema, resume=True)
            store = open_store(path, schema, resume=True, repair=True)
            left = np.flatnonzero(~store.done())
            assert tuple(left) == found.chunks, name
        _undo(path, whole)


def test_a_repaired_study_has_the_bits_of_the_whole(stored, tmp_path):
    path = copied(stored, tmp_path)
    _flip(path)
    (path / "observer" / "c" / "0").write_bytes(b"no")
    refused(path, "file observer/c/0 is not what was written; chunk 2 is not")
    studies.run_study(store=path, resume=True, repair=True)
    assert verify(path) == ((), (), ())
    assert_same(open_study(path), open_study(stored))


def test_a_second_study_on_one_store_is_refused(tmp_path):
    path = tmp_path / "run.zarr"
    with locked(path), pytest.raises(ValueError, match="Another process writes a study"):
        studies.run_study(store=path)
    studies.run_study(store=path)
    assert [each.name for each in tmp_path.iterdir()] == ["run.zarr"]


def test_opening_what_is_no_study(tmp_path):
    with pytest.raises(ValueError, match="not a study of aslo_jax"):
        open_study(tmp_path)


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


def test_worker_killed(tmp_path):
    """Two workers of a real cluster, one killed once the first chunks are done; the bits
    are those of one process, in a store and in memory."""
    many = dict(samples=20 * BLOCK, steps=1000, every=500, chunk=BLOCK)
    path = tmp_path / "run.zarr"
    killed = []
    with local_cluster(2) as client:
        workers = client.run(os.getpid)

        def kill():
            while len(list(path.glob("done/c/*"))) < 2:
                time.sleep(0.005)
            killed.append(len(list(path.glob("done/c/*"))))
            os.kill(next(iter(workers.values())), signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        found = studies.run_study(store=path, client=client, **many)
        killer.join()
        assert killed[0] < 20
        alone = studies.run_study(**many)
        assert_same(alone, found)


def test_a_sample_does_not_depend_on_how_many_there_are(whole):
    again = studies.run_study(samples=1)
    assert float(again["parameter_rate"][0]) == float(whole["parameter_rate"][0])
    np.testing.assert_array_equal(again["rms"][0], whole["rms"][0])
