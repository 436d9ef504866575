"""Other plants than the motor's: double integrator, wound-rotor induction machine, ball and
beam, each with an ASLO and an A-ASLO. Speed and error of every engine, with and without
noise. `systems.json` in the folder of the results keeps the figures."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .results import save

LANES, STEPS = 1024, 1000
FEW = 4  # trajectories of the references and of SciPy
RUNS, SLOW_RUNS = 5, 3
TOLERANCE = 1e-6
AGREEMENT = 1e-9  # of the largest true value, between fused and scan


def measure(name: str) -> list[dict[str, Any]]:
    import diffrax
    import jax
    import numpy as np

    import aslo_jax as aslo

    from . import loops, timing
    from .works import WORKS

    work = WORKS[name]
    batch = jax.tree.map(np.asarray, work.samples(LANES))
    few = jax.tree.map(lambda x: x[:FEW], batch)
    rows = []

    def turns(contenders: dict[str, Callable[[], Any]], runs, truth, lanes, noisy):
        seconds, values = timing.interleaved(contenders, runs)
        for engine, second in seconds.items():
            error = np.abs(np.asarray(values[engine])[:FEW] - truth).max(axis=(0, 2))
            row = {"engine": engine, "noisy": noisy, "lanes": lanes[engine]}
            row |= {"speed": row["lanes"] * STEPS / second / 1e6, "errors": error.tolist()}
            rows.append(row)
        return values

    for noisy in (False, True):
        exact = np.asarray(loops.exact(work, few, STEPS, noisy=noisy))
        engines = {
            engine: loops.Sampled(work, engine, batch, STEPS, noisy=noisy)
            for engine in ("fused", "scan")
        }
        fused, scan = (
            turns({engine: engines[engine]}, runs, exact, {engine: LANES}, noisy)[engine]
            for engine, runs in (("fused", RUNS), ("scan", SLOW_RUNS))
        )
        largest = np.abs(np.asarray(scan)[:, 0]).max()
        rows[-1]["agreement"] = float(np.abs(fused - scan).max() / largest)
        rows[-2]["operations"] = engines["fused"].operations
    truth = np.asarray(loops.continuous(work, few, STEPS, diffrax.Dopri8(), 1e-12)())
    peers = {
        "diffrax Tsit5": loops.continuous(work, batch, STEPS),
        "diffrax RungeKutta4": loops.continuous(work, batch, STEPS, aslo.RungeKutta4()),
        "diffrax, adaptive": loops.continuous(work, batch, STEPS, tolerance=TOLERANCE),
        "SciPy DOP853": loops.solve_ivp(work, few, STEPS, "DOP853", TOLERANCE),
    }
    lanes = {engine: FEW if engine.startswith("SciPy") else LANES for engine in peers}
    turns(peers, SLOW_RUNS, truth, lanes, False)
    return rows


def contend(path: str) -> None:
    """In a process of its own: measure, write the figures."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from .works import WORKS

    Path(path).write_text(json.dumps({name: measure(name) for name in WORKS}))


def report(figures: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Print the table; return what does not hold."""
    failures = []
    print(
        f"Other plants: {LANES:,} trajectories of {STEPS:,} steps, float64 (SciPy: {FEW}, "
        "on the compiled\nvector field of the modules); errors of the hidden states at the "
        f"end against Dopri8 at 1e-12, largest of {FEW}"
    )
    print(
        f"  {'':<20}{'':<21}{'noise':>6}{'M steps/s':>11}{'fused /':>9}{'ops':>6}"
        f"   errors: {'plant':>8}{'ASLO':>9}{'A-ASLO':>9}"
    )
    for name, rows in figures.items():
        fused = {r["noisy"]: r["speed"] for r in rows if r["engine"] == "fused"}
        for r in rows:
            errors = "".join(f"{e:9.1e}" for e in r["errors"])
            print(
                f"  {name:<20}{r['engine']:<21}{'yes' if r['noisy'] else 'no':>6}"
                f"{r['speed']:>11.3g} {fused[r['noisy']] / r['speed']:>8.4g}"
                f"{r.get('operations', ''):>6}{'':>10}{errors}"
            )
            if r.get("agreement", 0.0) > AGREEMENT:
                failures.append(
                    f"{name}: fused and scan differ by {r['agreement']:.1e} of the truth."
                )
    return failures


def main() -> list[str]:
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.systems", str(path)]
        subprocess.run(command, check=True, cwd=root)
        figures = json.loads(path.read_text())
    save("systems", figures)
    return report(figures)


if __name__ == "__main__":
    contend(*sys.argv[1:])
