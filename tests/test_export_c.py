"""Exported C: the numbers of the library, by a compiler that knows nothing of it."""

import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from compiled_c import compiled, compiler, error
from exported_motor import LOG, MOTOR, ROOT, command, motor_estimate, motor_log

import aslo_jax as aslo


@pytest.fixture(scope="module")
def motor(tmp_path_factory):
    """By the command of the page, without a further option."""
    folder = tmp_path_factory.mktemp("motor")
    given = ("export", MOTOR, "--target", "c", "--interval", "2e-4", "--out", folder)
    assert command(*given) == 0
    return folder


def test_the_recorded_motor_through_the_binary_is_replay(motor):
    log = motor_log()
    expected = motor_estimate()
    flags = "CFLAGS=-O2 -Werror -fno-math-errno"
    for target in ("test", "motor_csv"):
        subprocess.run(["make", "-s", target, flags], cwd=motor, check=True)
    with LOG.open() as text:
        done = subprocess.run(
            [motor / "motor_csv"], stdin=text, capture_output=True, text=True, check=True
        )
    head, *rows = done.stdout.splitlines()
    assert head == (
        "t,theta_electrical,certificate,coasting,coasting_speed,flux_alpha,flux_beta,"
        "omega_electrical"
    )
    found = np.array([row.split(",") for row in rows], float)
    np.testing.assert_array_equal(found[:, 0], log.t)
    assert error(found[:, 1:], expected) < 1e-12


def test_cmake_builds_and_runs_the_vectors(motor, tmp_path):
    cmake, ctest = shutil.which("cmake"), shutil.which("ctest")
    if cmake is None or ctest is None:
        pytest.skip("no cmake")
    found = shutil.which("make") or shutil.which("ninja")
    if found is None or compiler()[0] == sys.executable:
        pytest.skip("no make, ninja or compiler that cmake finds")
    steps = (
        [cmake, "-S", motor, "-B", tmp_path, f"-DCMAKE_C_COMPILER={compiler()[0]}"],
        [cmake, "--build", tmp_path],
        [ctest, "--test-dir", tmp_path, "--output-on-failure", "--no-tests=error"],
    )
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "motor_vectors" in done.stdout
    assert (tmp_path / "motor_csv").exists()


def test_compilers_have_nothing_to_say(motor, tmp_path):
    """Nor is a symbol missing, or kept outside of a function; with and without the
    processor's root."""
    for options in (("-O2",), ("-O0",), ("-O2", "-fno-math-errno"), ("-Os", "-DNDEBUG")):
        compiled(motor, "motor.c", "-c", *options)
        listed = subprocess.run(
            ["nm", "motor.o"], cwd=motor, capture_output=True, text=True, check=True
        ).stdout
        kinds = {line.split()[-2] for line in listed.splitlines()}
        assert kinds <= {"T", "t", "r", "R"}, (options, listed)
        names = {line.split()[-1] for line in listed.splitlines() if " T " in line}
        assert names == {"motor_defaults", "motor_init", "motor_step"}
    text = (motor / "motor.c").read_text()
    (motor / "motor.cpp").write_text(text)
    compiled(motor, "motor.cpp", "-c", "-Wall", "-Wextra", "-Werror", "-pedantic")
    words = set(re.findall(r"\b(\w*alloc|goto|double|static \w+ \w+ =)\b", text))
    assert words == {"double"}


def test_the_same_bytes_in_another_process(motor, tmp_path):
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    given = ["export", MOTOR, "--interval", "2e-4", "--out", tmp_path]
    subprocess.run(
        [sys.executable, "-m", "aslo_jax", *given], env=environment, check=True, cwd=ROOT
    )
    made = sorted(p.name for p in tmp_path.iterdir())
    assert {"motor.c", "motor.h", "main.c", "README.md", "CMakeLists.txt"} < set(made)
    for name in made:
        assert (tmp_path / name).read_bytes() == (motor / name).read_bytes(), name


def test_the_readme_lists_what_the_header_declares(motor):
    text, header = (motor / "README.md").read_text(), (motor / "motor.h").read_text()
    structs = {
        name: re.findall(r"^    \w+ (\w+)(?:\[\d+\])?;$", body, re.MULTILINE)
        for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", header, re.DOTALL)
    }
    sections = dict(re.findall(r"## (\w+)\n(.*?)(?=\n## |\Z)", text, re.DOTALL))
    listed = {k: re.findall(r"^\| `(\w+)` ", v, re.MULTILINE) for k, v in sections.items()}
    assert listed["Parameters"] == structs["motor_parameters"]
    assert listed["Outputs"] == structs["motor_output"]
    assert [*listed["State"], "begun"] == structs["motor_state"]
    arguments = re.search(r"motor_step\((.*?)\)", header, re.DOTALL)[1]
    assert set(listed["Inputs"]) <= set(re.findall(r"\w+", arguments))


def test_the_header_says_what_it_is(motor):
    header = (motor / "motor.h").read_text()
    for said in (
        f"aslo_jax {aslo.__version__}",
        "aslo-jax export motor.toml --target c --interval 0.0002",
        "Prop. 2",
        "i_alpha, i_beta; stationary frame, amplitude-invariant",
        "u was held over the",
        "rad/s, electrical",
        "operations in float64",
        "bytes and padding",
        "#define MOTOR_INTERVAL 0.0002",
    ):
        assert said in " ".join(header.replace("\n *", " ").split()), said
    assert not re.search(r"/(tmp|home|work|root)\b", header)


def test_columns_of_a_csv_file_that_lack_or_are_broken(motor):
    subprocess.run(["make", "-s", "motor_csv"], cwd=motor, check=True)
    given = {
        "t,u_alpha\n0,1\n": (2, "no column u_beta"),
        "t,u_alpha,u_beta,i_alpha,i_beta\n0,1,2,3,x\n": (2, "row 1: not 5 numbers"),
        "t,u_alpha,u_beta,i_alpha,i_beta\n0,1,2,3,nan\n": (1, "row 1: status 1"),
    }
    for text, (code, said) in given.items():
        done = subprocess.run(
            [motor / "motor_csv"], input=text, capture_output=True, text=True
        )
        assert (done.returncode, said in done.stderr) == (code, True), done.stderr


def test_sanitizers_and_the_stack(motor, tmp_path):
    """Nothing undefined in a run over the log, and no more of the stack than is said."""
    for name in ("motor.c", "motor.h", "main.c", "motor_csv.c"):
        (tmp_path / name).write_text((motor / name).read_text())
    flags = ("-O1", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }")
    works = subprocess.run([*compiler(), *flags, "-o", tmp_path / "probe", probe])
    if works.returncode:
        pytest.skip("this compiler has no sanitizers")
    done = subprocess.run(
        [*compiler(), "-std=c99", *flags, "-o", "checked", "motor_csv.c", "motor.c"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    with LOG.open() as text:
        ran = subprocess.run(
            [tmp_path / "checked"], stdin=text, capture_output=True, text=True
        )
    assert ran.returncode == 0, ran.stderr
    subprocess.run(
        [*compiler(), "-std=c99", "-O2", "-fstack-usage", "-c", "motor.c"],
        cwd=tmp_path,
        check=True,
    )
    used = {
        line.split("\t")[0].rpartition(":")[2]: int(line.split("\t")[1])
        for line in (tmp_path / "motor.su").read_text().splitlines()
    }
    said = re.search(
        r"at most (\d+) bytes of automatic",
        " ".join((motor / "motor.h").read_text().replace("\n *", " ").split()),
    )
    assert 0 < used["motor_step"] <= int(said[1])
