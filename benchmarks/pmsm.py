"""The engines side by side, on one closed loop: fused, scan, diffrax, SciPy, and C by hand.

`python -m benchmarks pmsm --quick` is the headline; without `--quick` it also measures how
the engines scale (`benchmarks/engines.py`). `pmsm.json` and `pmsm.png`
in the folder of the results keep the figures.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

LANES, STEPS = 1024, 1000
MANY = 8192  # lanes of fused and C, for which a thousand are done in hundredths of a second
RUNS = 7
SLOW_RUNS = 3  # of what takes seconds
FEW = 4  # trajectories of the reference and of SciPy
FIXED, ADAPTIVE = "diffrax Tsit5", "diffrax, adaptive"
C, SCHEDULED = "C", "C, scheduled"
TOLERANCE = 1e-6  # of the adaptive peers: their flux is then about as accurate as RK4's

# The bounds.
OVER_C, OVER_C_NOISY, OVER_DIFFRAX, OVER_SCIPY = 1.2, 1.0, 100.0, 1000.0
AGREEMENT = 1e-9  # Wb, between C and fused


def contend(path: str, quick: str) -> None:
    """In a process of its own: measure, write the figures."""
    import jax

    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as folder:
        figures: dict[str, Any] = {
            "compile": compile_times(),
            **headline(folder, quick == "quick"),
        }
        from . import engines, timing

        figures["scaling"] = engines.scaling(quick == "quick")
        figures["load"] = timing.load()
    Path(path).write_text(json.dumps(figures, indent=2) + "\n")


def compile_times() -> dict[str, float]:
    """Seconds from modules to the results of one step: trace, graph, LLVM, run."""
    from . import loops, motor_loop as work

    tiny = work.samples(32)
    # The tracer, the evaluator and LLVM itself are warm for whatever is measured.
    loops.Sampled(work.LOOP, "fused", tiny, 1, count=1)()
    found = {}
    for name, choice in {
        "ASLO and A-ASLO": {},
        "with noise": {"noisy": True},
        "ten ASLO": {"count": 10},
    }.items():
        start = time.perf_counter()
        loops.Sampled(work.LOOP, "fused", tiny, 1, **choice)()
        found[name] = time.perf_counter() - start
    return found


def headline(folder: str, quick: bool) -> dict[str, Any]:
    import diffrax
    import jax
    import numpy as np

    import aslo_jax as aslo

    from . import loops, motor_loop as work, numba_loop, timing
    from .by_hand import SCHEDULED as MORE, ByHand, solve_ivp

    many = jax.tree.map(np.asarray, work.samples(MANY))
    batch, few = (jax.tree.map(lambda x, n=n: x[:n], many) for n in (LANES, FEW))
    threads, runs = timing.processors(), 1 if quick else SLOW_RUNS
    hands = (
        {C: ByHand(folder), SCHEDULED: ByHand(folder, MORE)} if ByHand.available() else {}
    )

    rows: list[dict[str, Any]] = []
    for noisy in (False, True):
        exact = loops.exact(work.LOOP, few, STEPS, noisy=noisy)
        fast: dict[tuple[str, int], Any] = {}
        for n in sorted({threads, 1}, reverse=True):
            fast["fused", n] = loops.Sampled(
                work.LOOP, "fused", many, STEPS, n, noisy=noisy
            )
            for name, hand in hands.items():
                blocks = fastest(hand, batch, n, noisy)
                fast[name, n] = hand.sampled(blocks, many, STEPS, n, noisy)
        seconds, values = timing.interleaved(fast, RUNS)
        for (engine, n), second in seconds.items():
            found = row(engine, noisy, second, MANY, values[engine, n], exact, n)
            if engine in hands:
                found["operations"] = hands[engine].operations(noisy)
                difference = np.abs(values[engine, n] - values["fused", n])
                found["agreement"] = float(difference.max())
            else:
                found["operations"] = fast[engine, n].operations
            rows.append(found)
        slow: dict[str, Any] = {
            "scan": loops.Sampled(work.LOOP, "scan", batch, STEPS, noisy=noisy)
        }
        if numba_loop.available() and not quick:
            slow["Numba"] = numba_loop.sampled(batch, STEPS, threads, noisy)
        seconds, values = timing.interleaved(slow, runs)
        for name, second in seconds.items():
            rows.append(row(name, noisy, second, LANES, values[name], exact, threads))

    exact = loops.continuous(work.LOOP, few, STEPS, diffrax.Dopri8(), 1e-12)()
    peers = {
        FIXED: (loops.continuous(work.LOOP, batch, STEPS), LANES),
        ADAPTIVE: (loops.continuous(work.LOOP, batch, STEPS, tolerance=TOLERANCE), LANES),
        "SciPy RK45": (solve_ivp(few, STEPS, FEW, "RK45", TOLERANCE), FEW),
        "SciPy DOP853": (solve_ivp(few, STEPS, FEW, "DOP853", TOLERANCE), FEW),
    }
    if not quick:
        ours = loops.continuous(work.LOOP, batch, STEPS, aslo.RungeKutta4())
        peers["diffrax RungeKutta4"] = ours, LANES
    seconds, values = timing.interleaved({n: p[0] for n, p in peers.items()}, runs)
    for name, (_, lanes) in peers.items():
        rows.append(row(name, False, seconds[name], lanes, values[name], exact, threads))
    return {
        "rows": rows,
        "threads": threads,
        "slow runs": runs,
        "load before scaling": timing.load(),
    }


def fastest(hand: Any, batch, threads: int, noisy: bool) -> int:
    """The number of interleaved vectors with which C is fastest."""
    from . import timing

    run = {b: hand.sampled(b, batch, STEPS, threads, noisy) for b in hand.blocks}
    seconds, _ = timing.interleaved(run, SLOW_RUNS)
    return min(seconds, key=seconds.__getitem__)


def row(engine, noisy, seconds, lanes, value, exact, threads) -> dict[str, Any]:
    """The figures of one contender: its speed in million steps of a trajectory per second,
    and the largest errors of the first trajectories at the end."""
    import numpy as np

    error = np.abs(np.asarray(value)[:FEW] - np.asarray(exact)).max(axis=(0, 2))
    return {
        "engine": engine,
        "noisy": noisy,
        "threads": threads,
        "seconds": seconds,
        "lanes": lanes,
        "speed": lanes * STEPS / seconds / 1e6,
        "errors": error.tolist(),
    }


# ---- the report ----------------------------------------------------------------------


def speed(
    figures: dict[str, Any], engine: str, noisy: bool = False, threads: int | None = None
) -> float:
    """Of a contender, or of the fastest one of its kind, or not a number."""
    threads = figures["threads"] if threads is None else threads
    found = [
        r["speed"]
        for r in figures["rows"]
        if of_kind(r["engine"], engine) and (r["noisy"], r["threads"]) == (noisy, threads)
    ]
    return max(found, default=float("nan"))


def report(figures: dict[str, Any]) -> list[str]:
    """Print the table of the headline; return what does not hold."""
    print(
        f"PMSM, field-oriented control, ASLO and A-ASLO: {LANES:,} trajectories (fused and "
        f"C {MANY:,}) of {STEPS:,} steps\nof 0.1 ms, float64 (SciPy: one process, {FEW} "
        f"trajectories, extrapolated); medians of {RUNS} rounds in turn, "
        f"{figures['slow runs']} of the slow ones;\n{figures['load before scaling']}"
    )
    print(
        f"  {'':<20}{'noise':>6}{'threads':>9}{'M steps/s':>11}{'fused /':>9}{'ops':>6}"
        f"{'G ops/s/core':>14}   errors: {'flux':>8}{'ASLO':>9}{'A-ASLO':>9}"
    )
    for r in figures["rows"]:
        n = 1 if r["engine"].startswith("SciPy") else r["threads"]
        ratio = speed(figures, "fused", r["noisy"], r["threads"]) / r["speed"]
        operations = r.get("operations")
        rate = f"{operations * r['speed'] / 1e3 / n:.1f}" if operations else ""
        errors = "".join(f"{e:9.1e}" for e in r["errors"])
        print(
            f"  {r['engine']:<20}{'yes' if r['noisy'] else 'no':>6}{n:>9}"
            f"{r['speed']:>11.3f}{ratio:>9.4g}{operations or '':>6}{rate:>14}"
            f"{'':>10}{errors}"
        )
    print(
        f"  Errors (Wb) at the end, largest of {FEW} trajectories, against Dopri8 at "
        "1e-12: of the sampled loops\n  (fused, scan, C, Numba) over every interval, the "
        "voltage held; of the others over the loop in continuous\n  time. diffrax Tsit5 "
        "and RungeKutta4 (the library's) take steps of 0.1 ms, as many as the sampled\n  "
        f"loops; diffrax, adaptive is Tsit5 at {TOLERANCE:g}, as is SciPy. Operations: of "
        "fused, those of its graph;\n  of C, the vector instructions of its loop. A "
        "product with a sum counts as two. C, scheduled: with\n  -fschedule-insns and "
        "-fsched-pressure."
    )
    failures = []
    for noisy, bound in ((False, OVER_C), (True, OVER_C_NOISY)):
        check(
            failures,
            speed(figures, "fused", noisy) / speed(figures, C, noisy),
            bound,
            "fused / C" + (" with noise" if noisy else ""),
        )
        for name, n in ((C, 1), (SCHEDULED, None), (SCHEDULED, 1)):
            ratio = speed(figures, "fused", noisy, n) / speed(figures, name, noisy, n)
            what = name + (", one thread each" if n else "")
            if ratio == ratio:
                print(f"    {what:<30}{ratio:>9.4g}")
    fused = speed(figures, "fused")
    check(failures, fused / speed(figures, FIXED), OVER_DIFFRAX, "fused / diffrax")
    print(f"    with adaptive steps   {fused / speed(figures, ADAPTIVE):>9.4g}")
    check(failures, fused / speed(figures, "SciPy"), OVER_SCIPY, "fused / SciPy")
    for r in figures["rows"]:
        if r.get("agreement", 0.0) > AGREEMENT:
            failures.append(f"C and fused differ by {r['agreement']:.1e} Wb.")
    return failures


def of_kind(name: str, kind: str) -> bool:
    """Whether a contender is the one of that name, or one of that kind."""
    return f"{name} ".startswith(f"{kind} ")


def check(failures: list[str], value: float, bound: float, what: str) -> None:
    """Print a ratio beside its bound; not a number means not measured."""
    if value != value:
        print(f"  {what}: not measured, since there is no gcc")
        return
    print(f"  {what:<24}{value:>9.4g}   (at least {bound:g})")
    if value < bound:
        failures.append(f"{what} is {value:.3g}, less than {bound:g}.")


def main(quick: bool = False) -> list[str]:
    """Print the tables, save the figures and the plot; return what does not hold."""
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.pmsm", str(path)]
        # Threads of OpenMP that wait should not spin where others have work.
        environment = os.environ | {"OMP_WAIT_POLICY": "passive"}
        command.append("quick" if quick else "full")
        subprocess.run(command, check=True, cwd=root, env=environment)
        figures = json.loads(path.read_text())
    from . import engines, peers, results

    failures = report(figures) + engines.report(figures)
    fused = speed(figures, "fused")
    if not quick:
        figures["peers"] = peers.measure_all()
        peers.report(figures["peers"], fused)
    results.save("pmsm", figures)
    engines.plot(figures, str(results.FOLDER / "pmsm.png"))
    over = {n: fused / speed(figures, s) for n, s in PEERS.items()}
    written = {n: f"{r:.0f}" if r >= 100.0 else f"{r:.3g}" for n, r in over.items()}
    print("  ".join(f"fused/{name} {ratio}" for name, ratio in written.items()))
    return failures


PEERS = {"C": C, "diffrax": FIXED, "scipy": "SciPy"}

if __name__ == "__main__":
    contend(*sys.argv[1:])
