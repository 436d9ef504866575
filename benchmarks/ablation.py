"""What each pass of the fused engine is worth: four plants, quiet and with noise, on
registers of the host and, where these have 64 bytes, also of 32 (without AVX-512): the
speed of the whole pipeline over that of the pipeline without one pass, without turns
(`splitting`), and without either of the two orders of a step. One thread; `ablation.json`
in the folder of the results keeps the ratios."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .results import save

LANES, STEPS, RUNS = 256, 500, 9
ENDLESS = 10**9  # instructions in a turn: no turns
SPREAD = "the whole again"  # what two measurements of the same kernel differ by


def variants(work: Any, batch: Any, noisy: bool, target: Any) -> Iterator[tuple[str, Any]]:
    """The whole pipeline, and all without something."""
    from aslo_jax.engines._backend.step import Body, Step
    from aslo_jax.engines._passes import PASSES

    from .loops import Sampled

    def made(on: Any = target, without: tuple[str, ...] = ()) -> Sampled:
        run = Sampled(work, "fused", batch, STEPS, 1, on, noisy=noisy)
        run.program.without = without
        return run

    def in_order(which: int) -> Sampled:
        """With one of the orders, in all widths."""
        run = made()
        body = Body(run.program.loop)
        steps = (Step(body, w, target, which) for w in target.widths)
        run.program.__dict__["_step"] = min(steps, key=lambda step: step.cycles)
        return run

    yield "all", made()
    yield SPREAD, made()
    for name in dict.fromkeys(each.name for each in PASSES):
        yield name, made(without=(name,))
    yield "turns", made(target._replace(turn=ENDLESS))
    yield "the second order", in_order(0)
    yield "the first order", in_order(1)


def measure() -> dict[str, dict[str, float]]:
    """For each register, plant and noise: by variant, how much faster all is."""
    import jax
    import numpy as np

    from . import motor_loop, pmsm, timing
    from .works import WORKS

    found = {}
    for register, target in pmsm.registers().items():
        for name, work in {"motor": motor_loop.LOOP, **WORKS}.items():
            batch = jax.tree.map(np.asarray, work.samples(LANES))
            for noisy in (False, True):
                runs = dict(variants(work, batch, noisy, target))
                ratios = timing.ratios(runs, RUNS)
                found[f"{register} {name}{', noise' if noisy else ''}"] = ratios
    return found


def contend(path: str) -> None:
    """In a process of its own: measure, write the figures."""
    import jax

    jax.config.update("jax_enable_x64", True)
    Path(path).write_text(json.dumps(measure()))


def report(figures: dict[str, dict[str, float]]) -> list[str]:
    """Print the table; nothing can fail."""
    print(
        f"Speed of all passes over that without one, {LANES:,} trajectories of {STEPS:,} "
        f"steps,\none thread, medians of {RUNS} rounds in changing order"
    )
    names = list(next(iter(figures.values())))
    columns = list(figures)
    for k, column in enumerate(columns):
        print(f"  {k}: {column}")
    print(f"  {'':<18}" + "".join(f"{k:>7}" for k in range(len(columns))))
    for name in names[1:]:
        cells = "".join(f"{figures[c][name]:>7.3f}" for c in columns)
        print(f"  {name:<18}{cells}")
    return []


def main() -> list[str]:
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.ablation", str(path)]
        subprocess.run(command, check=True, cwd=root)
        figures = json.loads(path.read_text())
    save("ablation", figures)
    return report(figures)


if __name__ == "__main__":
    contend(*sys.argv[1:])
