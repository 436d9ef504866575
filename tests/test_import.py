"""What `import aslo_jax` needs and touches, each in a fresh interpreter."""

import ast
import json
import subprocess
import sys
from importlib.resources import files

import pytest

import aslo_jax
from aslo_jax.cli import _columns as columns

# Reached by name, and not by `from aslo_jax import *`.
PRIVATE_USE = {
    "completions",
    "experiment",
    "guard",
    "machines",
    "paper",
    "realise",
    "relations",
    "solvers",
    "structure",
}
EXTRAS = ("matplotlib", "pandas", "pyarrow", "pydantic", "tomlkit", "tqdm", "typer")


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


@pytest.fixture(scope="module")
def imported() -> dict:
    """What an interpreter has after the import, and whether it may still choose devices."""
    done = run(
        "import json, sys, aslo_jax, aslo_jax.logs, aslo_jax.cli, jax\n"
        "for name in aslo_jax.__all__:\n"
        "    getattr(aslo_jax, name)\n"
        f"extras = sorted(set(sys.modules) & set({EXTRAS!r}))\n"
        "double = jax.config.jax_enable_x64\n"
        "jax.config.update('jax_num_cpu_devices', 3)\n"
        "devices = jax.device_count('cpu')\n"
        "print(json.dumps(dict(extras=extras, double=double, devices=devices)))"
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_core_needs_no_extra():
    code = f"import sys; sys.modules.update(dict.fromkeys({EXTRAS!r}))\n"
    done = run(code + "import aslo_jax; print(aslo_jax.__version__)")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(".") == 2


def test_neither_the_package_nor_its_help_imports_jax():
    code = """
import sys, aslo_jax
from aslo_jax.cli import main

heavy = {"jax", "numpy", "diffrax", "scipy"}
print(sorted(heavy & set(sys.modules)), "machines" in dir(aslo_jax))
helps = ["--help"], ["--version"], ["study", "--help"], ["estimate", "--help"]
for arguments in (*helps, ["estimate", "--wrong"]):
    try:
        main(arguments)
    except SystemExit as left:
        print("left", left.code, sorted(heavy & set(sys.modules)))
from aslo_jax import *
print(replay is aslo_jax.replay, simulate.__name__, PhaseLockedLoop.__name__)
print(aslo_jax.plants.PMSM.__name__, aslo_jax.machines.KINDS["pmsm"].kind, aslo_jax.logs)
import aslo_jax.simulate
"""
    done = run(code)
    lines = done.stdout.splitlines()
    assert lines[0] == "[] True"
    left = [line for line in lines if line.startswith("left")]
    assert left == ["left 0 []"] * 4 + ["left 2 []"]
    assert "True simulate PhaseLockedLoop" in lines
    assert lines[-1].startswith("PMSM pmsm <module 'aslo_jax.logs'")
    assert done.stderr.endswith("No module named 'aslo_jax.simulate'\n")


def test_the_columns_in_the_help_are_those_of_the_machines():
    renew = f"they have changed: run `python -m {columns.__name__}`"
    assert columns.written() == columns.of_every_kind(), renew


def test_the_names_of_the_package_are_those_that_type_checkers_see():
    tree = ast.parse((files("aslo_jax") / "__init__.py").read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {name.name for line in block.body for name in line.names}
    assert seen | {"__version__"} == {*aslo_jax.__all__, *PRIVATE_USE}
    assert seen <= set(dir(aslo_jax))


def test_the_command_line_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "aslo_jax", "--version"], capture_output=True, text=True
    )
    assert done.stdout == f"aslo-jax {aslo_jax.__version__}\n"


def test_parts_are_imported_when_they_are_asked_for():
    code = """
import sys, aslo_jax

later = ("engines", "metrics", "study", "tune")
print([name for name in later if "aslo_jax." + name in sys.modules])
print([name for name in later if name not in dir(aslo_jax)])
print([name for name in later if getattr(aslo_jax, name).__name__ != "aslo_jax." + name])
print(aslo_jax.run_batch is aslo_jax.engines.run_batch, "Runner" in dir(aslo_jax))
from aslo_jax import NotFusible, study
print(NotFusible is aslo_jax.engines.NotFusible, study is aslo_jax.study)
try:
    aslo_jax.nothing
except AttributeError as error:
    print(error)
"""
    done = run(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        *["[]"] * 3,
        *["True True"] * 2,
        "module 'aslo_jax' has no attribute 'nothing'",
    ]


def test_extras_are_imported_when_they_are_used(imported):
    assert imported["extras"] == []


def test_import_computes_nothing(imported):
    """JAX refuses to change the number of devices once a computation has run. Constants
    made on import would also have the precision from before `jax_enable_x64` is set."""
    assert imported["double"] is False
    assert imported["devices"] == 3


WITHOUT = """
import sys

from aslo_jax.cli import main

for package in {packages!r}:
    sys.modules[package] = None  # as if it were not installed
    try:
        main({arguments!r})
    except SystemExit as left:
        print(left.code)
    del sys.modules[package]
    for name in [name for name in sys.modules if name.startswith("aslo_jax.cli.")]:
        del sys.modules[name]
"""


def test_command_line_names_the_missing_extra(tmp_path):
    data, packages = files("aslo_jax") / "data", ("typer", "pydantic", "pyarrow")
    machine, out = str(data / "motor.toml"), str(tmp_path / "estimate.csv")
    arguments = ["estimate", str(data / "pmsm_log.csv"), "--machine", machine, "--out", out]
    done = run(WITHOUT.format(packages=packages, arguments=arguments))
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "1", "1"]
    said = done.stderr.splitlines()
    for package, line in zip(packages, said, strict=True):
        assert f"`{package}` is not installed" in line
        assert 'pip install "aslo_jax[cli]"' in line
