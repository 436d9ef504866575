"""Signals to commands in processes of their own: at whatever instant they come, the command
ends at once, with one line, and leaves nothing that is not complete."""

import os
import random
import signal
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path

import pytest
from test_derive_cli import MODEL
from test_study_config import SMALL

import aslo_jax
from aslo_jax._interrupts import committing, ended_by_signals, unfinished

DATA = Path(str(files("aslo_jax") / "data"))
LOG = (str(DATA / "pmsm_log.csv"), "--machine", str(DATA / "motor.toml"))
COMMANDS = {
    "estimate": ("estimate", *LOG, "--out", "out.csv", "--plot", "out.png"),
    "calibrate": ("calibrate", *LOG, "--out", "out.toml"),
    "study": ("study", "in.toml", "--samples", "9999999", "--chunk", "256", "--out", "out"),
    "explore": ("explore", "--no-browser"),
    "tune": ("tune", "in.toml", "--samples", "4096", "--out", "out.toml"),
    "derive": ("derive", "plant.py:motor"),
    "export": ("export", LOG[2], "--out", "out", "--interval", "2e-4"),
    "fmu": ("export", LOG[2], "--out", "out", "--interval", "2e-4", "--target", "fmu3"),
    "paper": ("paper", "--section", "2", "--out", "out"),
}
GIVEN = {"in.toml": SMALL, "plant.py": MODEL}
START = "import sys; from aslo_jax.cli import main; print('begun', flush=True); main()"
INSTANTS = 4  # of every command
# Seconds until the end, at most, on any machine: a busy one starts threads late.
LATEST = 20.0


def interrupted(name: str, after: float, number: signal.Signals, folder: Path) -> str:
    """What a command said that was given a signal so many seconds after its first line."""
    for given, text in GIVEN.items():
        (folder / given).write_text(text)
    root = Path(aslo_jax.__file__).parents[1]
    process = subprocess.Popen(
        [sys.executable, "-c", START, *COMMANDS[name]],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    time.sleep(after)
    running = process.poll() is None
    process.send_signal(number)
    sent = time.perf_counter()
    _, said = process.communicate(timeout=60)
    assert time.perf_counter() - sent < LATEST
    # At the very end it is Python that ends; a shell says 128 + number then, too.
    if running and process.returncode not in (0, -number):
        assert process.returncode == 128 + number
    left = {each.name for each in folder.iterdir()} - set(GIVEN)
    if process.returncode in (0, -number):
        return ""
    assert left <= {"out"}
    assert not [*folder.rglob("*part*"), *folder.rglob(".*")]
    if left and name == "study":
        assert [each.name for each in (folder / "out").iterdir()] == ["study.zarr"]
    return said


@pytest.mark.parametrize(
    ("name", "after", "number", "word"),
    [
        ("estimate", 0.01, signal.SIGINT, "interrupted"),
        ("explore", 0.9, signal.SIGINT, "interrupted"),
        ("tune", 0.4, signal.SIGTERM, "terminated"),
        ("export", 0.5, signal.SIGINT, "interrupted"),
        ("study", 3.5, signal.SIGINT, "interrupted"),
    ],
)
def test_a_signal_ends_a_command(name, after, number, word, tmp_path):
    lines = interrupted(name, after, number, tmp_path).splitlines()
    assert lines[-1].startswith(f"aslo-jax: {word}")
    assert "Traceback" not in "\n".join(lines)
    if (tmp_path / "out").exists():
        assert lines[-1].endswith("what is done is kept, go on with --resume")


@pytest.mark.slow
def test_signals_at_random_instants(tmp_path):
    chance = random.Random(0)
    for name in COMMANDS:
        for k in range(INSTANTS):
            folder = tmp_path / f"{name}{k}"
            folder.mkdir()
            number = chance.choice((signal.SIGINT, signal.SIGTERM))
            said = interrupted(name, chance.uniform(0.0, 8.0), number, folder)
            assert "Traceback" not in said


def in_a_process(code: str) -> subprocess.CompletedProcess:
    start = "import os, signal, time\nfrom aslo_jax._interrupts import *\n"
    return subprocess.run(
        [sys.executable, "-c", start + code], capture_output=True, text=True, timeout=30
    )


def test_an_end_waits_for_what_is_being_committed():
    code = """
with ended_by_signals(restored=False), unfinished(lambda: os.write(1, b"removed\\n")):
    with committing():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.3)
        os.write(1, b"committed\\n")
    os.write(1, b"never\\n")
"""
    done = in_a_process(code)
    assert done.stdout == "committed\nremoved\n"
    assert (done.returncode, done.stderr) == (130, "aslo-jax: interrupted\n")


def test_code_that_swallows_interrupts_does_not_keep_one():
    code = """
with ended_by_signals(restored=False):
    while True:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except BaseException:
            pass
"""
    done = in_a_process(code)
    assert (done.returncode, done.stderr) == (143, "aslo-jax: terminated\n")


def test_handlers_are_restored():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with ended_by_signals(restored=True):
        assert signal.getsignal(signal.SIGINT) is not before[0]
        with unfinished(lambda: None), committing():
            pass
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before
