"""The public face under a type checker, as a user has it: installed, in strict mode."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMPLETE = 0.95

SCRIPT = """
from typing import assert_type

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.observers import Estimate, ObserverState

motor = aslo.plants.PMSM(
    resistance=8.875, inductance=40.03e-3, magnet_flux=0.2086, pole_pairs=5, inertia=6e-5
)
observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(20.0), start="paper")
loop = aslo.PhaseLockedLoop(np.float64(3.0))
t, u, angle = np.linspace(0.0, 1.0, 11), np.zeros((11, 2)), np.zeros(11)
assert_type(aslo.replay(loop, t, u, angle), Estimate)
assert_type(
    aslo.replay(loop, t, u, angle, return_state=True), tuple[Estimate, ObserverState]
)
both = aslo.SideBySide({"slow": observer, "fast": observer})
assert_type(aslo.replay(both, t, u, u)["slow"].value, jax.Array)
state = both.init(jnp.zeros(2))
assert_type(both.step(state, u[0], u[0], 1e-3)[1], dict[str, Estimate])
assert_type(aslo.replay(aslo.Unwrapped(loop, (True,)), t, u, angle), Estimate)


def voltage(t: jax.Array) -> jax.Array:
    return 10.0 * jnp.stack([jnp.cos(t), jnp.sin(t)])


run = aslo.simulate(motor, voltage, {"ASLO": observer}, t1=0.1)
assert_type(run.estimates["ASLO"].certificate, jax.Array)
assert_type(run.error("ASLO"), jax.Array)
experiment = aslo.Experiment(motor, voltage, {"ASLO": observer}, 1e-4)
assert_type(experiment.run(10).estimates["ASLO"].value, jax.Array)


def make(resistance: jax.Array) -> aslo.Experiment:
    return experiment


batch = aslo.run_batch(
    make, jnp.ones(4), 10, metrics={"rms": aslo.metrics.RMSError}, engine="scan"
)
found = aslo.study.run(
    experiment,
    {"resistance": ("plant.resistance", aslo.study.Normal(8.9, 0.1))},
    samples=4,
    key=jax.random.key(0),
    metrics={"rms": aslo.metrics.RMSError("ASLO")},
    steps=10,
)
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """An environment with the package in it, beside what this one has, and pyright."""
    pyright = pytest.importorskip("pyright").__name__
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    (site,) = (folder / "env" / "lib").glob("python*/site-packages")
    (site / "others.pth").write_text(sysconfig.get_path("purelib"))
    shutil.copytree(
        ROOT / "aslo_jax", site / "aslo_jax", ignore=shutil.ignore_patterns("__pycache__")
    )
    work = folder / "work"
    work.mkdir()
    path = f"{folder / 'env' / 'bin'}{os.pathsep}{os.environ['PATH']}"

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, "-m", pyright, "--outputjson", *arguments],
            cwd=work,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
        )
        return json.loads(done.stdout)

    return work, run


@pytest.mark.slow
def test_a_users_script_has_no_error_in_strict_mode(installed):
    work, run = installed
    (readme,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    for name, text in {"script": SCRIPT, "readme": readme}.items():
        (work / f"{name}.py").write_text(f"# pyright: strict\n{text}")
    found = run("script.py", "readme.py")["generalDiagnostics"]
    # What JAX leaves open is not for this package to close.
    ours = [x for x in found if not _subject(x).startswith(("jax.", "jnp."))]
    assert [x for x in ours if x["severity"] == "error"] == []


def _subject(found):
    """The text that a message is about."""
    at = found["range"]["start"]
    return Path(found["file"]).read_text().splitlines()[at["line"]][at["character"] :]


@pytest.mark.slow
def test_the_types_of_the_package_are_known(installed):
    _, run = installed
    found = run("--verifytypes", "aslo_jax", "--ignoreexternal")["typeCompleteness"]
    assert found["exportedSymbolCounts"]["withKnownType"] > 300
    assert found["completenessScore"] >= COMPLETE
