"""What `import aslo_jax` needs and touches, each in a fresh interpreter."""

import subprocess
import sys
from importlib.resources import files

import pytest

EXTRAS = ("matplotlib", "pandas", "pyarrow", "pydantic", "tqdm", "typer")


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def without(*modules: str) -> str:
    """The line after which `modules` look as if they were not installed."""
    return f"import sys; sys.modules.update(dict.fromkeys({modules!r}))\n"


def test_core_needs_no_extra():
    done = run(without(*EXTRAS) + "import aslo_jax; print(aslo_jax.__version__)")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(".") == 2


def test_extras_are_imported_when_they_are_used():
    done = run(f"import sys, aslo_jax; print(set(sys.modules) & set({EXTRAS!r}))")
    assert done.stdout.strip() == "set()", done.stderr


def test_import_computes_nothing():
    """JAX refuses to change the number of devices once a computation has run. Constants
    made on import would also have the precision from before `jax_enable_x64` is set."""
    done = run(
        "import aslo_jax, jax\n"
        "before = jax.config.jax_enable_x64\n"
        "jax.config.update('jax_num_cpu_devices', 3)\n"
        "print(before, jax.device_count('cpu'))"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["False", "3"]


@pytest.mark.parametrize("package", ["typer", "pydantic", "pyarrow"])
def test_command_line_names_the_missing_extra(package, tmp_path):
    data = files("aslo_jax") / "data"
    machine, out = str(data / "motor.toml"), str(tmp_path / "estimate.csv")
    arguments = ["estimate", str(data / "pmsm_log.csv"), "--machine", machine, "--out", out]
    done = run(
        without(package) + f"from aslo_jax.cli import main; main({arguments!r})",
    )
    assert done.returncode == 1, done.stderr
    assert f"`{package}` is not installed" in done.stderr
    assert 'pip install "aslo_jax[cli]"' in done.stderr
