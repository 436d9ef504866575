"""Batches of continuous co-simulations: fused beside heyoka and vmapped diffrax, CPU time
at equal error. `continuous.json` and `continuous.png`, the work-precision diagram, in the
folder of the results keep the figures.

heyoka (`pip install heyoka`) is measured where it is installed, with its defaults and with
`fast_math`. Every time is the least of some rounds in turn, every error that against
heyoka at 1e-17, about 1e-15."""

import importlib.util
import json
import random
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from . import results

LANES, FEW = 4096, 64  # of fused and heyoka, and of diffrax
EXACT = 16  # of the reference of the other plants
ERRORS = (1e-6, 1e-8, 1e-10, 1e-12)  # Wb
OVER_HEYOKA = (2.0, 1.6, 1.3, 1.1)
OVER_DIFFRAX, TIMES_TOLERANCE, COMPILE = 50.0, 10.0, 3.0
TOLERANCE = 1e-6  # of diffrax, at whose error the plants are compared
TOLERANCES = (1e-4, 2e-5, 1e-6, 1e-7)  # of fused there
SPAN = {
    "PMSM": 0.1,
    "double integrator": 2.0,
    "WRIM": 0.1,
    "ball and beam": 2.0,
    "leg": 2.0,
}


def cpu() -> float:
    """Seconds of all threads of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def measured(
    contenders: Mapping[Any, tuple[Callable[[], Any], int]], rounds: int
) -> dict[Any, float]:
    """The least microseconds of CPU time of a trajectory, in turns."""
    order, found = list(contenders), {name: [] for name in contenders}
    shuffle = random.Random(1).shuffle
    for _ in range(rounds):
        shuffle(order)
        for name in order:
            run, lanes = contenders[name]
            start = cpu()
            run()
            found[name].append((cpu() - start) / lanes * 1e6)
    return {name: min(times) for name, times in found.items()}


def contend(path: str, quick: str) -> None:
    """In a process of its own: measure, write the figures."""
    import jax

    jax.config.update("jax_enable_x64", True)
    short = quick == "quick"
    figures = {"motor": motor(short), "plants": {} if short else plants()}
    Path(path).write_text(json.dumps(figures, indent=2) + "\n")


def motor(short: bool) -> list[dict[str, Any]]:
    """Work and error of every contender on the open-loop motor, by tolerance."""
    import jax
    import numpy as np

    from aslo_jax.engines._adaptive.pairs import LOOSE

    from . import continuous_works as works

    samples, few = works.motors(LANES), works.motors(FEW)
    contenders: dict[Any, tuple[Callable[[], Any], int]] = {}
    compiled: dict[float, float] = {}
    near = [1.01 * LOOSE, 0.99 * LOOSE]  # either pair
    tolerances = [1e-4, *near, 1e-6]
    if not short:
        tolerances = [1e-4, 5e-5, *near, *(10.0**-k for k in range(5, 13))]
    for rtol in tolerances:
        for threads in (1, 2):
            how = dict(engine="fused", rtol=rtol, atol=1e-2 * rtol, threads=threads)
            run = works.batch(works.open_loop, samples, **how)
            start = cpu()
            run()
            compiled.setdefault(rtol, cpu() - start)
            contenders["fused", threads, rtol] = run, LANES
    if importlib.util.find_spec("heyoka"):
        for tol in [1e-4, 1e-5, 1e-6] if short else [10.0**-k for k in range(2, 14)]:
            for kind in ({}, {"fast_math": True}):
                name = ", ".join(["heyoka", *kind])
                contenders[name, 1, tol] = works.Heyoka(samples, tol, **kind), LANES
    for rtol in [1e-6, 1e-7] if short else [10.0**-k for k in range(4, 11)]:
        how = dict(rtol=rtol, atol=1e-2 * rtol)
        contenders["diffrax", 1, rtol] = works.batch(works.open_loop, few, **how), FEW
    if importlib.util.find_spec("heyoka"):
        exact = works.Heyoka(samples, 1e-17)()
    else:
        how = dict(engine="fused", rtol=1e-14, atol=1e-16)
        exact = works.batch(works.open_loop, samples, **how)()
    values = {name: run() for name, (run, _) in contenders.items()}
    times = measured(contenders, 5 if short else 7)
    rows = []
    for name, value in values.items():
        engine, threads, tolerance = name
        reference = exact[: len(value)]
        if engine == "diffrax":  # the first of another draw
            how = dict(engine="fused", rtol=1e-14, atol=1e-16)
            reference = works.batch(works.open_loop, few, **how)()
        row = {"engine": engine, "threads": threads, "tolerance": tolerance}
        row |= {
            "microseconds": times[name],
            "error": float(np.abs(value - reference).max()),
        }
        if engine == "fused":
            row["compile"] = compiled[tolerance]
        rows.append(row)
    jax.clear_caches()
    return rows


def plants() -> dict[str, list[dict[str, Any]]]:
    """The plants of the benchmark `systems` with ASLO and A-ASLO: fused at some tolerances,
    and diffrax at one. The error is the largest at the end, of the hidden part and of each
    estimate, over its size."""
    import diffrax
    import jax
    import numpy as np

    from . import continuous_works as works

    found = {}
    for name, work in works.PLANTS.items():
        one, rows = works.closed(work, SPAN[name]), []
        samples = jax.tree.map(np.asarray, work.samples(LANES))
        few, fewer = (jax.tree.map(lambda x, n=n: x[:n], samples) for n in (FEW, EXACT))
        tight = diffrax.PIDController(rtol=1e-12, atol=1e-14)
        exact = works.batch(
            one, fewer, solver=diffrax.Dopri8(), stepsize_controller=tight
        )()
        size = np.abs(exact).max(axis=(0, 2))
        contenders: dict[Any, tuple[Callable[[], Any], int]] = {}
        for rtol in TOLERANCES:
            how = dict(engine="fused", rtol=rtol, atol=1e-2 * rtol, threads=1)
            contenders["fused", rtol] = works.batch(one, samples, **how), LANES
        how = dict(rtol=TOLERANCE, atol=1e-2 * TOLERANCE)
        contenders["diffrax", TOLERANCE] = works.batch(one, few, **how), FEW
        values, compiled = {}, {}
        for key, (run, _) in contenders.items():
            start = cpu()
            values[key] = run()
            compiled[key] = cpu() - start
        times = measured(contenders, 3)
        for key, value in values.items():
            error = np.abs(value[:EXACT] - exact).max(axis=(0, 2)) / size
            row = {"engine": key[0], "threads": 1, "tolerance": key[1]}
            row |= {"microseconds": times[key], "error": float(error.max())}
            rows.append(row | {"compile": compiled[key] - 1e-6 * LANES * times[key]})
        found[name] = rows
        print(name, rows, file=sys.stderr, flush=True)
        jax.clear_caches()
    return found


def cost(rows: list[dict[str, Any]], engine: str, error: float) -> float:
    """Microseconds of a trajectory at an error, by its best solver: interpolated between
    the tolerances, logarithm by logarithm."""
    import numpy as np

    points = sorted(
        (r["error"], r["microseconds"])
        for r in rows
        if r["engine"] == engine and r["threads"] == 1
    )
    front: list[tuple[float, float]] = []
    for e, t in points:  # a larger error must have saved time
        while front and front[-1][1] <= t:
            if front[-1][0] <= e:
                break
            front.pop()
        else:
            front.append((e, t))
    e, t = np.log(np.array(front)).T
    return float(np.exp(np.interp(np.log(error), e, t)))


def report(figures: dict[str, Any], short: bool) -> list[str]:
    rows, failures = figures["motor"], []
    engines = list(dict.fromkeys(r["engine"] for r in rows))
    print("Open-loop PMSM with the filters of its ASLO, 0.1 s; CPU time per trajectory")
    print(f"  {'engine':<20}{'threads':>8}{'tolerance':>11}{'us':>9}{'error, Wb':>12}")
    for r in rows:
        print(
            f"  {r['engine']:<20}{r['threads']:>8}{r['tolerance']:>11.0e}"
            f"{r['microseconds']:>9.2f}{r['error']:>12.1e}"
            + (f"   compiled in {r['compile']:.1f} s" if "compile" in r else "")
        )
        if r["engine"] == "fused" and r["compile"] > COMPILE:
            failures.append(f"fused takes {r['compile']:.1f} s to compile.")
        if r["engine"] == "fused" and r["error"] > TIMES_TOLERANCE * max(
            r["tolerance"], 1e-12
        ):
            failures.append(
                f"fused has an error of {r['error']:.1e} at {r['tolerance']:.0e}"
            )
    for error, bound in zip(ERRORS, OVER_HEYOKA, strict=True):
        if short and error != 1e-8:
            continue
        ours = cost(rows, "fused", error)
        over = {e: cost(rows, e, error) / ours for e in engines if e != "fused"}
        words = ", ".join(f"{r:.3g} over {e}" for e, r in over.items())
        print(f"  at an error of {error:.0e} Wb: {ours:.2f} us, {words}")
        if over.get("heyoka", bound) < bound:
            failures.append(
                f"{over['heyoka']:.2f} over heyoka at {error:.0e}, not {bound}."
            )
    for name, own in figures["plants"].items():
        other = next(r for r in own if r["engine"] == "diffrax")
        print(
            f"  {name}: diffrax, tolerance {other['tolerance']:.0e}, "
            f"{other['microseconds']:.0f} us, error {other['error']:.1e}"
        )
        for r in own:
            if r is not other:
                print(
                    f"    fused {r['tolerance']:>9.0e}{r['microseconds']:>9.1f} us, error "
                    f"{r['error']:.1e}; compiled in {r['compile']:.1f} s"
                )
                if r["compile"] > COMPILE:
                    failures.append(f"{name}: {r['compile']:.1f} s to compile.")
        ratio = other["microseconds"] / cost(own, "fused", other["error"])
        print(f"    at that error {ratio:.0f} over diffrax")
        if ratio < OVER_DIFFRAX:
            failures.append(f"{name}: {ratio:.0f} over diffrax, not {OVER_DIFFRAX:.0f}.")
    ratios = {e: cost(rows, e, 1e-8) / cost(rows, "fused", 1e-8) for e in engines}
    heyoka = f"{ratios['heyoka']:.3g}" if "heyoka" in ratios else "-"
    print(f"fused/heyoka {heyoka}  fused/diffrax {ratios['diffrax']:.3g}")
    return failures


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """The work-precision diagram."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    for engine in dict.fromkeys(r["engine"] for r in rows):
        points = [r for r in rows if r["engine"] == engine and r["threads"] == 1]
        errors = [r["error"] for r in points]
        axes.loglog(errors, [r["microseconds"] for r in points], "o-", label=engine)
    axes.set_xlabel("largest error of flux and estimate (Wb)")
    axes.set_ylabel("CPU time of a trajectory (us)")
    axes.set_title("Open-loop PMSM with the filters of its ASLO, 0.1 s")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main(short: bool = False) -> list[str]:
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        mode = "quick" if short else "whole"
        command = [sys.executable, "-m", "benchmarks.continuous", str(path), mode]
        subprocess.run(command, check=True, cwd=root)
        figures = json.loads(path.read_text())
    results.save("continuous", figures)
    plot(figures["motor"], results.FOLDER / "continuous.png")
    return report(figures, short)


if __name__ == "__main__":
    contend(*sys.argv[1:])
