"""Ten million steps of an observer, in float64 and float32: memory that stays what it was,
one compilation, and an estimate that has not drifted.

In loops of XLA for every observer, and a million by single calls from Python for one, each
case in a process of its own. The record of a motor repeats, so that the estimate after any
number of turns of it is known: what it was after the first.
"""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from . import results, timing

STEPS, CALLS, BLOCK = 10_000_000, 1_000_000, 10_000
FIRST = 20  # blocks until an observer has settled, after which memory and estimate count
ROWS, INTERVAL = 2000, 1e-4  # of the record, s
R, L, M = 1.3, 4e-3, 0.09  # ohm, H, Wb
CURRENT, VOLTAGE = 0.01, 0.1  # A, V: standard deviations of noise
OBSERVERS = ("ASLO", "Lifted", "Adaptive")
MEMORY = 10.0  # MB, growth at most
# Of the magnet's flux: change of the estimate, and its error, at most.
DRIFT = {"float64": 1e-6, "float32": 1e-4}
ERROR = 0.02


def record() -> tuple[Any, Any, Any]:
    """u, the mean of the interval before the sample, y and the flux, of a turn of a record
    that repeats: 300 to 500 rad/s (electrical), a current that swings, noise."""
    import numpy as np

    t = INTERVAL * np.arange(2 * ROWS + 1) / 2  # and between the samples
    base = 2.0 * np.pi / (INTERVAL * ROWS)
    angle = 13.0 * base * t + 3.0 * np.sin(base * t)
    size = 2.0 + 0.9 * np.sin(2.0 * base * t + 0.3)
    circle = lambda a: np.stack([np.cos(a), np.sin(a)], axis=1)
    y = size[:, None] * circle(angle + 1.9)
    flux = L * y + M * circle(angle)
    mean = (y[:-2:2] + 4.0 * y[1::2] + y[2::2]) / 6.0
    u = R * mean + (flux[2::2] - flux[:-2:2]) / INTERVAL
    rng = np.random.default_rng(8)
    u = u + VOLTAGE * rng.standard_normal(u.shape)
    return u, y[2::2] + CURRENT * rng.standard_normal(u.shape), flux[2::2]


def observer_of(name: str) -> Any:
    import aslo_jax as aslo

    relation = aslo.plants.FluxRelation(R, L, M)
    if name == "ASLO":
        return aslo.AlgebraicObserver(relation, aslo.LowPass(60.0))
    return getattr(aslo, name)(relation, CURRENT, VOLTAGE)


def megabytes() -> float:
    """That the process has now, or where the system does not tell, has had at most."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def soak(name: str, dtype: str, how: str, steps: int, first: int = FIRST) -> dict[str, Any]:
    """So many steps of an observer by `how`, `"scan"` or `"calls"`; what changed from the
    observer after the `first` blocks to the last."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    observer = jax.tree.map(
        lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x, observer_of(name)
    )
    u, y, flux = (np.asarray(x, dtype) for x in record())
    traces = 0

    def one(state: Any, u: Any, y: Any) -> Any:
        nonlocal traces
        traces += 1
        return observer.step(state, u, y, INTERVAL)

    @jax.jit
    def block(state: Any) -> Any:
        def row(state: Any, k: Any) -> Any:
            state, found = one(state, jnp.asarray(u)[k], jnp.asarray(y)[k])
            return state, (found.value, found.coasting)

        state, (value, coasting) = jax.lax.scan(row, state, jnp.arange(BLOCK) % ROWS)
        return state, value[-1], coasting.sum()

    single = jax.jit(one)

    def called(state: Any) -> Any:
        coasting, value = 0, None
        for k in range(BLOCK):
            state, found = single(state, u[k % ROWS], y[k % ROWS])
            value, coasting = found.value, coasting + bool(found.coasting)
        return state, value, coasting

    run = {"scan": block, "calls": called}[how]
    state, memory, once, coasted = observer.init(y[0], u[0]), 0.0, 0, 0
    value = settled = np.zeros(2)
    start = time.process_time()
    for k in range(steps // BLOCK):
        state, value, coasting = run(state)
        value = np.asarray(value)
        assert value.dtype == dtype, value.dtype
        if k + 1 == first:
            settled, memory, once = value, megabytes(), traces
        coasted += int(coasting) if k >= first else 0
    return {
        "steps": steps,
        "microseconds": (time.process_time() - start) / steps * 1e6,
        "memory": megabytes() - memory,
        "retraced": traces - once,
        "drift": float(np.linalg.norm(value - settled)) / M,
        "error": float(np.linalg.norm(value - flux[-1])) / M,
        "coasted": coasted,
    }


def faults(name: str, f: dict[str, Any], dtype: str) -> list[str]:
    """What does not hold of the figures of a case."""
    found = []
    if f["memory"] > MEMORY:
        found.append(f"{name}: {f['memory']:.1f} MB more than when it had settled.")
    if f["retraced"]:
        found.append(f"{name}: traced again {f['retraced']} times.")
    if not f["drift"] <= DRIFT[dtype]:
        found.append(f"{name}: drifted by {f['drift']:.1e} of the magnet's flux.")
    if not f["error"] <= ERROR:
        found.append(f"{name}: is off by {f['error']:.1e} of the magnet's flux.")
    if f["coasted"]:
        found.append(f"{name}: coasted in {f['coasted']} steps.")
    return found


def main() -> list[str]:
    """Print and keep the figures; return what does not hold."""
    cases = [(name, dtype, "scan") for name in OBSERVERS for dtype in DRIFT]
    cases += [("ASLO", dtype, "calls") for dtype in DRIFT]
    figures, failures = {}, []
    print(
        f"Steps without an end, {timing.load()}: processor time of one, then what changed"
    )
    for case in cases:
        command = [sys.executable, "-m", "benchmarks.soak", *case]
        root = Path(__file__).parents[1]
        done = subprocess.run(
            command, check=True, stdout=subprocess.PIPE, text=True, cwd=root
        )
        f, name = json.loads(done.stdout), ", ".join(case)
        figures[name] = f
        print(
            f"  {name:<26}{f['steps']:>12,}{f['microseconds']:>8.2f} us"
            f"{f['memory']:>8.1f} MB, traced {f['retraced']}, drift {f['drift']:.1e}, "
            f"error {f['error']:.1e}, coasting {f['coasted']}",
            flush=True,
        )
        failures += faults(name, f, case[1])
        results.save("soak", figures)
    return failures


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    who, precision, how = sys.argv[1:]
    steps = STEPS if how == "scan" else CALLS
    print(json.dumps(soak(who, precision, how, steps)))
