"""Inputs and machines that fail: one line that names what, and nothing half written."""

import csv
import os
import resource
import stat
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from aslo_jax._written import write_files
from aslo_jax.cli import main
from aslo_jax.cli._outputs import staged
from aslo_jax.machines._speed import turning_acceleration, turning_speed

DATA = Path(str(files("aslo_jax") / "data"))
LOG, MOTOR = DATA / "pmsm_log.csv", DATA / "motor.toml"


def failed(capsys, *arguments: object, code: int = 2) -> str:
    """The one line that a command ends with."""
    with pytest.raises(SystemExit) as caught:
        main([str(each) for each in arguments])
    said = capsys.readouterr().err
    assert caught.value.code == code, said
    assert said.startswith("aslo-jax: error: ") and said.count("\n") == 1
    return said


def test_links_in_a_loop(tmp_path, capsys):
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    estimate = ("estimate", "--out", tmp_path / "o.csv")
    for arguments in (
        (*estimate, loop, "--machine", MOTOR),
        (*estimate, LOG, "--machine", loop),
        ("estimate", LOG, "--machine", MOTOR, "--out", loop),
        ("study", loop, "--samples", 2, "--out", tmp_path / "study"),
        ("study", "pmsm", "--samples", 2, "--out", loop),
    ):
        assert f"{loop} cannot be followed" in failed(capsys, *arguments)
    assert list(tmp_path.iterdir()) == [loop]


@pytest.mark.parametrize("command", ["estimate", "study", "tune"])
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = " + b"[" * 5000 + b"]" * 5000, "nested too deeply"),
        (b'title = "\xff\xfe"', "can't decode byte 0xff"),
    ],
)
def test_toml_that_cannot_be_read(command, content, said, tmp_path, capsys):
    path, out = tmp_path / "in.toml", tmp_path / "o.toml"
    path.write_bytes(content)
    arguments = {
        "estimate": ("estimate", LOG, "--machine", path, "--out", tmp_path / "o.csv"),
        "study": ("study", path, "--samples", 2, "--out", tmp_path / "o"),
        "tune": ("tune", path, "--out", out),
    }
    message = failed(capsys, *arguments[command])
    assert f"{path} is not valid TOML: " in message and said in message
    assert list(tmp_path.iterdir()) == [path]


def test_control_characters_are_escaped_and_messages_bounded(tmp_path, capsys):
    path = tmp_path / "m.toml"
    arguments = ("estimate", LOG, "--machine", path, "--out", tmp_path / "o.csv")
    path.write_text('[machine]\nkind = "\\u001b[2J\\u0007"\n')
    message = failed(capsys, *arguments)
    assert message[:-1].isprintable() and "\\x1b[2J\\x07" in message.replace("\\\\", "\\")
    path.write_text(f'[machine]\nkind = "{"x" * 9000}"\n')
    message = failed(capsys, *arguments)
    assert len(message) < 1100 and str(path) in message


def test_a_module_that_exits(tmp_path, capsys):
    path = tmp_path / "m.toml"
    arguments = ("estimate", LOG, "--machine", path, "--out", tmp_path / "o.csv")
    path.write_text('[machine]\nkind = "mechanical"\nsystem = "sys:exit"\n')
    assert "calling exit() failed with SystemExit" in failed(capsys, *arguments)
    (tmp_path / "leaves_at_once.py").write_text("raise SystemExit(0)\n")
    path.write_text('[machine]\nkind = "mechanical"\nsystem = "leaves_at_once:x"\n')
    assert "importing it failed with SystemExit" in failed(capsys, *arguments)


def test_a_full_disk_is_named(tmp_path):
    """As the limit of the size of a file, which the system reports at the same place."""
    code = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (9999, 9999))\n"
    code += "from aslo_jax.cli import main; main()"
    arguments = ("estimate", LOG, "--machine", MOTOR, "--out", tmp_path / "o.csv", "-q")
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True,
        # Python 3.11 would keep what it compiles cut at the limit, for all that follow.
        env={k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
        | {"PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"aslo-jax: error: cannot write {tmp_path / 'o.csv'}: ")
    assert list(tmp_path.iterdir()) == []
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 9999


def test_an_output_keeps_the_mode_of_what_it_replaces(tmp_path):
    path = tmp_path / "a.csv"
    for mode in (0o640, 0o604):
        path.write_text("earlier")
        path.chmod(mode)
        with staged(path) as (part,):
            part.write_text("new")
        assert path.read_text() == "new" and path.stat().st_mode & 0o777 == mode


def rows(factor: float, cell: float | None = None) -> list[list[str]]:
    head, *body = csv.reader(LOG.read_text().splitlines()[:600])
    found = [[row[0], *(repr(factor * float(x)) for x in row[1:])] for row in body]
    if cell is not None:
        found[300][head.index("i_beta")] = repr(cell)
    return [head, *found]


def estimated(tmp_path, capsys, body, *more):
    """The table of a log, and what was said."""
    log, out = tmp_path / "log.csv", tmp_path / "o.csv"
    with log.open("w", newline="") as file:
        csv.writer(file).writerows(body)
    with pytest.raises(SystemExit) as caught:
        main(["estimate", str(log), "--machine", str(MOTOR), "--out", str(out), *more])
    assert not caught.value.code
    table = np.genfromtxt(out, delimiter=",", names=True)
    return table, capsys.readouterr().err


def test_numbers_that_are_not_finite_are_counted(tmp_path, capsys):
    table, said = estimated(tmp_path, capsys, rows(1e150))
    bad = int((~np.isfinite(np.array(table.tolist()))).any(axis=1).sum())
    assert bad > 0
    assert f"{bad} of {len(table)} rows of the table hold" in said


def test_after_a_number_whose_square_is_none_it_coasts_and_says_so(tmp_path, capsys):
    table, said = estimated(tmp_path, capsys, rows(1.0, 1e155), "--outliers", "keep")
    assert "the outputs of row 300 cannot be right" in said
    assert table["coasting"][300:].all() and not table["coasting"][100:299].any()
    bad = int((~np.isfinite(np.array(table.tolist()))).any(axis=1).sum())
    assert not bad or f"{bad} of {len(table)} rows of the table hold" in said


@pytest.mark.parametrize("power", [-700, 530])
def test_rates_of_a_log_do_not_depend_on_its_scale(power):
    """A vector that turns ever faster, times a power of two: to the last bit."""
    t = np.arange(4000) * 1e-4
    angle = 30.0 * t + 25.0 * t**2
    v = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert abs(turning_acceleration(t, v) - 50.0) < 0.1
    for rate in (turning_speed, turning_acceleration):
        assert rate(t, np.ldexp(v, power)) == rate(t, v)


def test_several_files_appear_together_or_not_at_all(tmp_path):
    (tmp_path / "a").write_bytes(b"before")
    (tmp_path / "a").chmod(0o640)
    (tmp_path / "c").mkdir()
    with pytest.raises(OSError, match="cannot write"):
        write_files(tmp_path / "c", {"a": b"written", "x/y": b"has no folder"})
    assert write_files(tmp_path, {"a": b"after", "b": b"new"}) == [
        tmp_path / "a",
        tmp_path / "b",
    ]
    assert (tmp_path / "a").read_bytes() == b"after"
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a", "b", "c"]
    assert not list((tmp_path / "c").iterdir())
