"""Stores of studies: killed, half written, damaged, foreign, repaired, and refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import studies
import xarray
import zarr

from aslo_jax.metrics import RMSError
from aslo_jax.study import open_study, run
from aslo_jax.study._lock import locked
from aslo_jax.study._store import open_store, verify
from aslo_jax.study._verification import own_checksum

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def schema():
    """That of the store: a study is traced once for the tests that need no more."""
    return studies.study_of().schema


def copied(stored, tmp_path):
    return Path(shutil.copytree(stored, tmp_path / "run.zarr"))


KILLED = """
import os, signal, sys, jax
jax.config.update("jax_enable_x64", True)
import zarr
from studies import run_study

count, write = 0, zarr.Array.__setitem__

def counted(array, place, value):
    global count
    count += array.ndim > 0 and array.shape[0] == 600 or array.path == "internal/done"
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
    half = xarray.open_zarr(path)
    assert (zarr.open_group(path)["internal/done"][:] != 0).tolist() == [True, False, False]
    assert np.isfinite(half["parameter_rate"][:256]).all()
    assert np.isnan(half["parameter_rate"][512:]).all()
    resumed = studies.run_study(store=path, resume=True)
    studies.assert_same(whole, resumed)


def test_half_written_and_left_over_files(whole, stored, tmp_path):
    """A chunk without its mark is computed again, whatever its files hold."""
    path = copied(stored, tmp_path)
    (path / "internal" / "done" / "c" / "1").unlink()
    (path / "rms" / "c" / "1" / "0" / "0").write_bytes(b"half")
    left = path / "rms" / "c" / "1" / "0" / "0.1234.partial"
    left.write_bytes(b"of a write")
    beside = tmp_path / ".run.zarr.partial"
    beside.mkdir()
    studies.assert_same(whole, studies.run_study(store=path, resume=True))
    assert not left.exists()


def test_killed_while_the_store_is_made(whole, tmp_path):
    beside = tmp_path / ".run.zarr.partial"
    beside.mkdir()
    (beside / "zarr.json").write_text("{")
    path = tmp_path / "run.zarr"
    studies.assert_same(whole, studies.run_study(store=path, resume=True))
    assert not beside.exists()


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
    content["attributes"]["checksum"] = own_checksum(content)
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
    path, full = copied(stored, tmp_path), ("internal/done", *schema.order)
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
        array, _, chunk = name.partition("/c/")
        if name == "zarr.json":  # what study it is is not known any more
            for ask in (verify, open_study):
                with pytest.raises(ValueError, match=r"damaged study|not a study"):
                    ask(path)
        elif array == "internal/done" and chunk and harm == "gone":
            assert verify(path).missing == (int(chunk),)
        else:
            found, samples = verify(path), bool(chunk) and array in full
            assert found, name
            number = int(chunk.split("/")[0]) if samples else None
            assert found.chunks == ((number,) if samples else ()), name
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
    studies.assert_same(open_study(path), open_study(stored))


def test_a_second_study_on_one_store_is_refused(tmp_path):
    path = tmp_path / "run.zarr"
    with locked(path), pytest.raises(ValueError, match="Another process writes a study"):
        studies.run_study(store=path)
    studies.run_study(store=path)
    assert [each.name for each in tmp_path.iterdir()] == ["run.zarr"]


def test_variables_are_in_the_order_of_memory(whole, stored):
    """However the files of a store are listed."""
    found = open_study(stored)
    assert list(found.data_vars) == list(whole.data_vars)
    assert list(found.coords) == list(whole.coords)
    assert list(found.dims) == list(whole.dims)


def test_opening_what_is_no_study(tmp_path):
    with pytest.raises(ValueError, match="not a study of aslo_jax"):
        open_study(tmp_path)


def test_xarray_opens_a_store_as_it_is(stored, tmp_path):
    """Without a warning (an error here), without what is internal, and writes it as NetCDF
    of the oldest kind; xarray before 2026.4 writes no text of a store there, but ours."""
    dataset = xarray.open_zarr(stored)
    ours = open_study(stored)
    assert set(dataset.data_vars) == set(ours.data_vars)
    assert "done" not in dataset and "internal" not in dataset
    new = tuple(map(int, xarray.__version__.split(".")[:2])) >= (2026, 4)
    (dataset if new else ours).to_netcdf(tmp_path / "study.nc", engine="scipy")
    back = xarray.open_dataset(tmp_path / "study.nc", engine="scipy")
    for name, variable in ours.data_vars.items():
        np.testing.assert_array_equal(back[name].values, variable.values)
    assert back.attrs["configuration"] == dataset.attrs["configuration"]


def test_a_copy_of_a_description_that_is_damaged_is_told(stored, tmp_path):
    """xarray believes the copy."""
    path = copied(stored, tmp_path)
    text = (path / "zarr.json").read_text()
    for name in ('"float64"', '"chunk_shape"'):
        assert name in text.split("consolidated_metadata")[1]
        head, _, tail = text.rpartition(name)
        (path / "zarr.json").write_text(f"{head}{name[:-2]}6{name[-1:]}{tail}")
        with pytest.raises(ValueError, match=r"damaged study: its zarr\.json is not what"):
            verify(path)
