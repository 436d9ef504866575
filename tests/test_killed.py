"""`kill -9` at any instant of a study: `--resume` goes on to the bits, and to the files, of
a study that nothing ended."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from studies import assert_same

import aslo_jax
from aslo_jax.study import open_study
from aslo_jax.study._store import verify

KILLS, SEED = 20, 190723
SAMPLES, CHUNK = 9 * 1024, 256  # 36 chunks
STUDY = """
title = "Killed again and again"
interval = 0.013
horizon = 0.78
every = 12

[machine]
kind = "double_integrator"
speed = -0.37

[control]
kind = "open_loop"
signal = { kind = "wave", amplitude = 1.7, frequency = 2.9, phase = 0.4 }

[observers.ASLO]
kind = "aslo"
cutoff = 7.3

[observers.Luenberger]
kind = "luenberger"
gain = 4.1

[[sensor]]
kind = "noise"
deviation = 0.017

[spread.speed]
where = "initial.1"
distribution = "normal"
mean = -0.2
deviation = 0.6

[metrics.rms]
kind = "rms"
after = 0.26

[metrics.coasting]
kind = "coasting"
"""


def study(folder: Path, out: str, *options: str) -> subprocess.Popen:
    root = Path(aslo_jax.__file__).parents[1]
    start = "from aslo_jax.cli import main; main()"
    given = ("study", "in.toml", "--samples", str(SAMPLES), "--chunk", str(CHUNK))
    return subprocess.Popen(
        [sys.executable, "-c", start, *given, "--out", out, "--quiet", *options],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(root)},
    )


def finished(process: subprocess.Popen) -> None:
    _, said = process.communicate(timeout=600)
    assert process.returncode == 0, said


def done(folder: Path) -> int:
    """Chunks that are marked."""
    return len([*folder.glob("out*/study.zarr/internal/done/c/*")])


def names(folder: Path) -> list[str]:
    return sorted(str(each.relative_to(folder)) for each in folder.rglob("*"))


@pytest.mark.slow
def test_kills_at_random_instants(tmp_path):
    """Every other one at an instant of the run, from the first import on; the others some
    milliseconds after a chunk was marked, where files are being written."""
    chance = random.Random(SEED)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    for folder in (whole, killed):
        folder.mkdir()
        (folder / "in.toml").write_text(STUDY)
    begun = time.perf_counter()
    finished(study(whole, "out", "--no-report"))
    most = 0.6 * (time.perf_counter() - begun)
    finished(study(whole, "out", "--resume"))  # makes the report
    out, kills, ended, amid = 0, 0, [], 0
    while kills < KILLS:
        before = done(killed)
        process = study(killed, f"out{out}", "--resume", "--no-report")
        begun = time.perf_counter()
        if kills % 2:
            until = begun + chance.uniform(0.0, most)
        else:
            wanted = before + chance.randint(1, 6)
            while done(killed) < wanted and process.poll() is None:
                time.sleep(0.001)
            until = time.perf_counter() + chance.uniform(0.0, 0.02)
        while time.perf_counter() < until and process.poll() is None:
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        _, said = process.communicate()
        if process.returncode == -signal.SIGKILL:
            kills += 1
            amid += done(killed) > before
        else:  # it was over; the next begins anew
            assert process.returncode == 0, said
            ended.append(out)
            out += 1
    assert amid >= KILLS // 4
    finished(study(killed, f"out{out}", "--resume"))
    assert names(killed / f"out{out}") == names(whole / "out")
    expected = open_study(whole / "out" / "study.zarr")
    for each in (*ended, out):
        path = killed / f"out{each}" / "study.zarr"
        assert verify(path) == ((), (), ())
        assert_same(expected, open_study(path))
