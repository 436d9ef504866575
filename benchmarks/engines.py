"""How the engines scale: size of the batch, horizon, threads, observers side by side, the
time to compile, forward gradients, the replay of a long log. Part of the benchmark `pmsm`.
"""

import math
from collections.abc import Callable
from typing import Any

RUNS = 7
LANES, STEPS = 1024, 1000
# Up to which the size of the batch is varied.
SIZES = {"fused": 10**6, "C": 10**6, "Numba": 10**4, "scan": 10**4, "diffrax": 10**3}
SAMPLES = 1_000_000  # of the replay

# The bounds.
THREADS, TEN_OBSERVERS, GRADIENT, REPLAY, FLAT = 1.8, 0.35, 2.6, 1.0, 1.2
AGREEMENT = 1e-10  # of the largest flux after 1 s, between fused and scan
COMPILE, COMPILE_TEN = 2.0, 5.0  # s


def scaling(quick: bool) -> dict[str, Any]:
    """All figures; if `quick`, those that take seconds."""
    found: dict[str, Any] = {"threads": threads(), "observers": observers()}
    if not quick:
        found |= {"gradient": gradient(), "agreement": agreement(), "paper": paper()}
        found |= {"horizon": horizon(), "replay": replay(), "sizes": sizes()}
    return found


def _batch(count: int):
    import jax
    import numpy as np

    from . import motor_loop as work

    return jax.tree.map(np.asarray, work.samples(count))


def threads() -> dict[str, float]:
    """Million steps of a trajectory per second with one thread and with two."""
    from . import loops, motor_loop as work, timing

    batch = _batch(LANES)
    run = {
        str(n): loops.Sampled(work.LOOP, "fused", batch, STEPS, threads=n) for n in (1, 2)
    }
    seconds, _ = timing.interleaved(run, RUNS)
    return {n: LANES * STEPS / s / 1e6 for n, s in seconds.items()}


def observers() -> list[dict[str, float]]:
    """1, 5 and 10 ASLO with other filters beside each other: steps and operations."""
    from . import loops, motor_loop as work, timing

    batch = _batch(LANES)
    counts = 1, 5, 10
    run = {n: loops.Sampled(work.LOOP, "fused", batch, STEPS // 4, count=n) for n in counts}
    seconds, _ = timing.interleaved(run, RUNS)
    rows = []
    for n in counts:
        speed = LANES * (STEPS // 4) / seconds[n] / 1e6
        operations = run[n].operations
        rows.append({"observers": n, "speed": speed, "operations": operations})
    return rows


def gradient() -> dict[str, float]:
    """Seconds of the values, and of the values with forward derivatives in two gains."""
    import jax
    import jax.numpy as jnp

    from aslo_jax.engines import run_batch
    from aslo_jax.metrics import RMSError

    from . import motor_loop as work, timing

    resistance, magnet, keys = _batch(LANES)

    metrics = {"rms": RMSError("A-ASLO", 0.02)}

    def loss(gains):
        spread = [jnp.full(LANES, g) for g in gains]
        batch = (resistance, magnet, keys, *spread)
        make = lambda s: work.make(s[:3], gains=s[3:])
        found = run_batch(make, batch, STEPS // 2, metrics=metrics, engine="fused")
        return jnp.mean(found.metrics["rms"])

    gains = jnp.array([work.RATE, work.GAIN])
    both = jax.jacfwd(lambda gains: (loss(gains),) * 2, has_aux=True)
    primal, tangent = jax.jit(loss), jax.jit(both)
    run = {
        "primal": lambda: jax.block_until_ready(primal(gains)),
        "gradient": lambda: jax.block_until_ready(tangent(gains)),
    }
    seconds, _ = timing.interleaved(run, RUNS)
    return seconds


def agreement() -> float:
    """The largest difference of fused and scan after 1 s, over the largest flux."""
    import numpy as np

    from . import loops, motor_loop as work

    batch, steps = _batch(32), round(1.0 / work.INTERVAL)
    both = [loops.Sampled(work.LOOP, e, batch, steps)() for e in ("fused", "scan")]
    a, b = map(np.asarray, both)
    return float(np.abs(a - b).max() / np.abs(b).max())


def horizon() -> list[dict[str, float]]:
    """Seconds of one batch over 100 to 100,000 steps."""
    from . import loops, motor_loop as work, timing

    batch = _batch(LANES)
    steps = 100, 1000, 10_000, 100_000
    run = {str(n): loops.Sampled(work.LOOP, "fused", batch, n) for n in steps}
    seconds, _ = timing.interleaved(run, 3)
    return [
        {"steps": n, "seconds": seconds[str(n)], "speed": LANES * n / seconds[str(n)] / 1e6}
        for n in steps
    ]


def paper() -> dict[str, float]:
    """Million steps per second of the observers as printed: paper's start, Repeat."""
    from . import loops, motor_loop as work, timing

    batch = _batch(LANES)
    run = {
        e: loops.Sampled(work.LOOP, e, batch, STEPS, paper=True) for e in ("fused", "scan")
    }
    seconds, _ = timing.interleaved(run, 3)
    return {e: LANES * STEPS / s / 1e6 for e, s in seconds.items()}


def replay() -> dict[str, float]:
    """Seconds to replay a log of a million samples: fused, scan, a cascade of `lfilter`."""
    import jax

    import aslo_jax as aslo

    from . import replay as recorded, timing
    from .by_hand import ByHand

    t, u, y, _ = recorded.log(SAMPLES)
    relation = aslo.plants.FluxRelation(recorded.RESISTANCE, recorded.INDUCTANCE)
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(recorded.RATE))
    run: dict[str, Callable[[], Any]] = {
        e: lambda e=e: jax.block_until_ready(aslo.replay(observer, t, u, y, engine=e))
        for e in ("fused", "scan")
    }
    run["lfilter"] = recorded.cascade(t, u, y)
    if ByHand.available():
        run["C"] = recorded.by_hand(t, u, y)
    return timing.interleaved(run, 5)[0]


def sizes() -> dict[str, list[dict[str, float]]]:
    """Million steps per second for batches of 1 to a million trajectories, in turn."""
    import tempfile

    from . import loops, motor_loop as work, numba_loop, timing
    from .by_hand import ByHand

    run: dict[Any, Callable[[], Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        hand = ByHand(folder) if ByHand.available() else None
        for count in (10**k for k in range(7)):
            batch, threads = _batch(count), timing.processors()
            each = {
                "fused": lambda b=batch: loops.Sampled(work.LOOP, "fused", b, STEPS),
                "scan": lambda b=batch: loops.Sampled(work.LOOP, "scan", b, STEPS),
                "diffrax": lambda b=batch: loops.continuous(work.LOOP, b, STEPS),
            }
            if hand:
                of_c = lambda b=batch, n=threads: hand.sampled(2, b, STEPS, n)
                each["C"] = of_c
            if numba_loop.available():
                of_numba = lambda b=batch, n=threads: numba_loop.sampled(b, STEPS, n)
                each["Numba"] = of_numba
            run |= {(k, count): f() for k, f in each.items() if count <= SIZES[k]}
        seconds, _ = timing.interleaved(run, 3)
    found: dict[str, list[dict[str, float]]] = {}
    for (name, count), second in seconds.items():
        speed = count * STEPS / second / 1e6
        found.setdefault(name, []).append({"lanes": count, "speed": speed})
    return found


# ---- the report ----------------------------------------------------------------------


def report(figures: dict[str, Any]) -> list[str]:
    """Print the tables; return what does not hold."""
    scale, failures = figures["scaling"], []

    def check(value: float, bound: float, what: str, most: bool = False) -> None:
        word = "at most" if most else "at least"
        print(f"  {what:<44}{value:>9.3g}   ({word} {bound:g})")
        if not (value <= bound if most else value >= bound):
            failures.append(f"{what}: {value:.3g}, must be {word} {bound:g}.")

    print(
        f"\nThe fused engine, {LANES:,} trajectories, medians of {RUNS}; {figures['load']}"
    )
    ratio = scale["threads"]["2"] / scale["threads"]["1"]
    if figures["threads"] == 2:
        check(ratio, THREADS, "two threads over one")
        rows = [r for r in figures["rows"] if r["engine"] == "C" and not r["noisy"]]
        hand = {r["threads"]: r["speed"] for r in rows}
        if hand:
            print(f"  {'the same of C, in the rounds above':<44}{hand[2] / hand[1]:>9.3g}")
    first, *_, last = rows = scale["observers"]
    for r in rows:
        rate = r["speed"] * r["operations"] / 1e3
        print(
            f"  {r['observers']:>3} ASLO{r['operations']:>8} operations"
            f"{r['speed']:>9.1f} M steps/s{rate:>9.1f} G operations/s"
        )
    share = last["speed"] * last["operations"] / (first["speed"] * first["operations"])
    check(share, TEN_OBSERVERS, "rate of operations, ten ASLO over one")
    if "gradient" in scale:
        seconds = scale["gradient"]
        ratio = seconds["gradient"] / seconds["primal"]
        check(ratio, GRADIENT, "gradient in two gains over the values", most=True)
        what = "fused less scan after 1 s, over the flux"
        check(scale["agreement"], AGREEMENT, what, most=True)
    for name, second in figures["compile"].items():
        bound = COMPILE_TEN if name.startswith("ten") else COMPILE
        check(second, bound, f"seconds to trace and compile, {name}", most=True)
    for r in scale.get("horizon", ()):
        print(
            f"  {r['steps']:>9,} steps{r['seconds']:>10.3f} s{r['speed']:>9.1f} M steps/s"
        )
    if "paper" in scale:
        fused, scan = scale["paper"]["fused"], scale["paper"]["scan"]
        print(
            "  as printed (paper's start, Repeat), M steps/s:"
            f"{fused:>9.1f} fused{scan:>8.2f} scan"
        )
    if "replay" in scale:
        seconds = scale["replay"]
        print(f"  replay of {SAMPLES:,} samples: " + listed(seconds, "s"))
        check(seconds["lfilter"] / seconds["fused"], REPLAY, "replay, lfilter over fused")
    if "sizes" in scale:
        print("  M steps/s by size of the batch")
        for name, rows in scale["sizes"].items():
            speeds = "".join(f"{r['speed']:>10.3g}" for r in rows)
            print(f"  {name:<10}{speeds}")
        cost = {
            n: _slope(rows) for n, rows in scale["sizes"].items() if n in ("fused", "C")
        }
        check(
            cost["fused"], FLAT, "cost of a trajectory, 1e3 to 1e6, most/least", most=True
        )
        if "C" in cost:
            print(f"  {'the same of C':<44}{cost['C']:>9.3g}")
    return failures


def _slope(rows: list[dict[str, float]]) -> float:
    """The largest cost of a trajectory over the smallest, from a thousand on."""
    speeds = [r["speed"] for r in rows if r["lanes"] >= 1000]
    return max(speeds) / min(speeds)


def listed(values: dict[str, float], unit: str) -> str:
    return ", ".join(f"{name} {value:.3g} {unit}" for name, value in values.items())


def plot(figures: dict[str, Any], path: str) -> None:
    """Speed over the size of the batch, or the headline alone, both axes logarithmic."""
    from aslo_jax.plot._canvas import Canvas, grid, styled
    from aslo_jax.plot._style import color

    from .pmsm import of_kind

    with styled():
        canvas = Canvas(6.4, 4.4)
        ((axes,),) = grid(canvas, [1.0], left=0.9, top=0.4)
        sizes = figures["scaling"].get("sizes", {})
        for k, (name, rows) in enumerate(sizes.items()):
            x, y = [r["lanes"] for r in rows], [1e6 * r["speed"] for r in rows]
            axes.loglog(x, y, "o-", label=name, color=color(k))
        for k, r in enumerate(figures["rows"], len(sizes)):
            known = any(of_kind(r["engine"], name) for name in sizes)
            if not known and not r["noisy"] and r["threads"] == figures["threads"]:
                axes.loglog(
                    r["lanes"], 1e6 * r["speed"], "s", label=r["engine"], color=color(k)
                )
        axes.set(xlabel="trajectories", ylabel="steps of a trajectory per second")
        axes.set_title(f"PMSM, ASLO and A-ASLO, {figures['threads']} threads")
        low, high = axes.get_ylim()
        axes.set_ylim(10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high)))
        axes.grid(True, which="both", alpha=0.3)
        axes.legend(fontsize="small")
        canvas.savefig(path, dpi=150, bbox_inches="tight")
