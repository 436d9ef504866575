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
# Of fused over the faster C, quiet and with noise, by the bytes of the host's registers.
OVER_C = {32: (1.12, 1.10), 64: (1.0, 1.05)}
OVER_DIFFRAX, OVER_SCIPY = 100.0, 1000.0
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
    from .by_hand import ByHand, solve_ivp
    from .clock import hertz, share

    many = jax.tree.map(np.asarray, work.samples(MANY))
    batch, few = (jax.tree.map(lambda x, n=n: x[:n], many) for n in (LANES, FEW))
    threads, runs = timing.processors(), 1 if quick else SLOW_RUNS
    targets = registers()
    hands = by_hands(folder, targets) if ByHand.available() else {}

    rows: list[dict[str, Any]] = []
    for noisy in (False, True):
        exact = loops.exact(work.LOOP, few, STEPS, noisy=noisy)
        fast: dict[tuple[str, int, int], Any] = {}
        for n in sorted({threads, 1}, reverse=True):
            for register, target in targets.items():
                fast["fused", n, register] = loops.Sampled(
                    work.LOOP, "fused", many, STEPS, n, target, noisy=noisy
                )
            for (name, register), hand in hands.items():
                blocks = fastest(hand, batch, n, noisy)
                fast[name, n, register] = hand.sampled(blocks, many, STEPS, n, noisy)
        seconds, values = timing.interleaved(fast, RUNS)
        clock = hertz()
        for key, second in seconds.items():
            engine, n, register = key
            found = row(engine, noisy, second, MANY, values[key], exact, n)
            found["register"] = register
            if engine == "fused":
                step, speed = fast[key].step, found["speed"] * 1e6 / n
                found["operations"], found["lanes at a time"] = (
                    fast[key].operations,
                    step.width,
                )
                found["share"], found["clock"] = share(step, speed, clock), clock
            else:
                found["operations"] = hands[engine, register].operations(noisy)
                difference = np.abs(values[key] - values["fused", n, register])
                found["agreement"] = float(difference.max())
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
        "host": host(),
        "register": next(iter(targets)),
        "slow runs": runs,
        "load before scaling": timing.load(),
    }


def registers() -> dict[int, Any]:
    """The targets of this host by the bytes of their registers: its own, and on AVX-512
    also itself without it."""
    from aslo_jax.engines._runtime.host import target

    own = target()
    return {own.register: own} | ({32: target(32)} if own.register == 64 else {})


def by_hands(folder: str, targets: dict[int, Any]) -> dict[tuple[str, int], Any]:
    """C as GCC compiles it, and scheduled, for each of the registers."""
    from .by_hand import NARROW, SCHEDULED as MORE, ByHand

    own = next(iter(targets))
    return {
        (name, register): ByHand(folder, [*more, *(() if register == own else NARROW)])
        for register in targets
        for name, more in ((C, ()), (SCHEDULED, MORE))
    }


def host() -> str:
    """The name of the processor."""
    import platform

    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    fields = {k.strip(): v.strip() for k, v in fields.items()}
    family = [fields.get(k, "") for k in ("cpu family", "model")]
    name = fields.get("model name", platform.processor())
    return f"{name}, family {family[0]}, model {family[1]}" if all(family) else name


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
    figures: dict[str, Any],
    engine: str,
    noisy: bool = False,
    threads: int | None = None,
    register: int | None = None,
) -> float:
    """Of a contender, or of the fastest one of its kind, or not a number; with the host's
    own registers where no others are named."""
    own = figures["register"]
    wanted = (noisy, threads or figures["threads"], register or own)
    found = [
        r["speed"]
        for r in figures["rows"]
        if of_kind(r["engine"], engine)
        and (r["noisy"], r["threads"], r.get("register", own)) == wanted
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
    own = figures["register"]
    print(f"{figures['host']}; registers of {own} bytes")
    print(
        f"  {'':<20}{'bytes':>6}{'noise':>6}{'threads':>9}{'M steps/s':>11}{'fused /':>9}"
        f"{'ops':>6}{'G ops/s/core':>14}   errors: {'flux':>8}{'ASLO':>9}{'A-ASLO':>9}"
    )
    for r in figures["rows"]:
        n = 1 if r["engine"].startswith("SciPy") else r["threads"]
        bytes_ = r.get("register", own)
        ratio = speed(figures, "fused", r["noisy"], r["threads"], bytes_) / r["speed"]
        operations = r.get("operations")
        rate = f"{operations * r['speed'] / 1e3 / n:.1f}" if operations else ""
        errors = "".join(f"{e:9.1e}" for e in r["errors"])
        noise, width = "yes" if r["noisy"] else "no", r.get("register", "")
        print(
            f"  {r['engine']:<20}{width:>6}{noise:>6}{n:>9}"
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
    for r in figures["rows"]:
        if "share" in r:
            what = (
                f"{r['register']} bytes, {r['lanes at a time']} lanes at a time"
                f"{', with noise' if r['noisy'] else ''}, {r['threads']} thread"
            )
            print(
                f"    {what:<50}{r['share']:>6.0%} of the products that the ports can make "
                f"at {r['clock'] / 1e9:.2f} GHz"
            )
    over_c(figures, failures)
    fused = speed(figures, "fused")
    check(failures, fused / speed(figures, FIXED), OVER_DIFFRAX, "fused / diffrax")
    print(f"    with adaptive steps   {fused / speed(figures, ADAPTIVE):>9.4g}")
    check(failures, fused / speed(figures, "SciPy"), OVER_SCIPY, "fused / SciPy")
    for r in figures["rows"]:
        if r.get("agreement", 0.0) > AGREEMENT:
            failures.append(f"C and fused differ by {r['agreement']:.1e} Wb.")
    return failures


def over_c(figures: dict[str, Any], failures: list[str]) -> None:
    """Fused over the faster of C and C scheduled: on the host's own registers with bounds,
    and on narrower ones, which say nothing certain about a host that has no others."""
    own, most = figures["register"], figures["threads"]
    for register in sorted({r.get("register", own) for r in figures["rows"]}, reverse=True):
        for noisy, bound in zip((False, True), OVER_C[register], strict=True):
            for n in sorted({most, 1}, reverse=True):
                pair = (speed(figures, e, noisy, n, register) for e in (C, SCHEDULED))
                ratio = speed(figures, "fused", noisy, n, register) / max(pair)
                what = "fused / faster C" + (", noise" if noisy else "")
                what += f", {n} thread{'s' if n > 1 else ''}"
                if register == own:
                    check(failures, ratio, bound, what)
                elif ratio == ratio:
                    print(f"    without AVX-512: {what:<34}{ratio:>9.4g}")


def of_kind(name: str, kind: str) -> bool:
    """Whether a contender is the one of that name, or one of that kind."""
    return f"{name} ".startswith(f"{kind} ")


def check(failures: list[str], value: float, bound: float, what: str) -> None:
    """Print a ratio beside its bound; not a number means not measured."""
    if value != value:
        print(f"  {what}: not measured, since there is no gcc")
        return
    print(f"  {what:<36}{value:>9.4g}   (at least {bound:g})")
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
