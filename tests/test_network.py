"""The commands need no network, nor do the processes that they start: what leaves this
machine is refused to them (`offline/sitecustomize.py`), and nothing was asked for."""

import json
import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from test_derive_cli import MODEL
from test_study_config import SMALL

import aslo_jax

DATA = Path(str(files("aslo_jax") / "data"))
LOG = (str(DATA / "pmsm_log.csv"), "--machine", str(DATA / "motor.toml"))
QUICK = (
    ("sample", "--out", "sample"),
    ("estimate", *LOG, "--out", "out.csv", "--plot", "out.png"),
    ("derive", "plant.py:motor"),
    ("export", LOG[2], "--out", "c", "--interval", "2e-4"),
    ("study", "in.toml", "--samples", "256", "--out", "study"),
)
LONG = (
    ("export", LOG[2], "--out", "fmu", "--interval", "2e-4", "--target", "fmu3"),
    ("study", "in.toml", "--samples", "256", "--out", "study", "--workers", "2"),
    ("calibrate", *LOG, "--out", "out.toml"),
    ("tune", "in.toml", "--samples", "64", "--iterations", "2", "--out", "out.toml"),
    ("paper", "--section", "2", "--out", "paper"),
)
ALL = """
import json, sys
from aslo_jax.cli import main
if __name__ == "__main__":
    for arguments in json.loads(sys.argv[1]):
        try:
            main(arguments)
        except SystemExit as left:
            print("exit", left.code)
"""


def offline(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """A process of Python that reaches nothing; what it asked for is in `attempts`."""
    paths = (Path(__file__).parent / "offline", Path(aslo_jax.__file__).parents[1])
    given = {
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "ASLO_JAX_TEST_NETWORK": str(folder / "attempts"),
    }
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | given,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("commands", [QUICK, pytest.param(LONG, marks=pytest.mark.slow)])
def test_commands_reach_nothing(commands, tmp_path):
    (tmp_path / "sample").mkdir()
    (tmp_path / "in.toml").write_text(SMALL)
    (tmp_path / "plant.py").write_text(MODEL)
    (tmp_path / "all.py").write_text(ALL)
    done = offline(tmp_path, "all.py", json.dumps(commands))
    assert done.stdout.count("exit 0\n") == len(commands), done.stdout + done.stderr
    assert not (tmp_path / "attempts").exists()


@pytest.mark.parametrize(
    "code",
    [
        "import socket; socket.create_connection(('example.org', 80))",
        "import socket; socket.socket().connect(('192.0.2.1', 80))",
        "import urllib.request; urllib.request.urlopen('https://example.org')",
        "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import socket; "
        'socket.gethostbyname("example.org")\'], check=True)',
    ],
)
def test_what_reaches_out_is_refused_and_noticed(code, tmp_path):
    done = offline(tmp_path, "-c", code)
    assert done.returncode != 0 and "no network: socket." in done.stderr
    assert (tmp_path / "attempts").read_text().startswith("socket.")


def test_this_machine_is_reached(tmp_path):
    code = (
        "import socket\n"
        "with socket.create_server(('127.0.0.1', 0)) as server:\n"
        "    socket.create_connection(('localhost', server.getsockname()[1])).close()\n"
    )
    assert offline(tmp_path, "-c", code).returncode == 0
    assert not (tmp_path / "attempts").exists()
