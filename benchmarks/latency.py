"""How long a control loop waits for one step: the median and the 99.9th percentile of
single calls from Python of the compiled step, NumPy arrays in, the estimate as a NumPy
array out, beside a compiled call that takes and returns the same and computes nothing.

The process has one processor to itself as far as the system allows (`pin`), Python
collects no garbage meanwhile, and the contenders take turns in blocks whose order changes.
Time is told twice: of the clock, for which a loop waits, and of the processor, in which
nobody else has a part. The intervals of 95 % are those of SciPy's `quantile_test`, which
takes calls for independent and nothing else.
"""

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import results, timing

CALLS, BLOCK, WARM = 20_000, 250, 1000
INTERVAL = 1e-4  # s
# Processor time of the median call over that of an empty one, at most, by `jax.jit`:
# measured 1.4, 2.1 and 2.0.
BOUNDS = {"ASLO": 2.0, "Lifted": 3.0, "Adaptive": 3.0}
QUANTILES = {"median": 0.5, "99.9 %": 0.999}
CLOCKS = ("processor", "clock")


def pin() -> bool:
    """Keep this process on the last processor that it may use; whether that is possible.
    Before JAX is imported, which makes a thread for every one."""
    if not hasattr(os, "sched_setaffinity"):
        return False
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    return True


def contenders() -> dict[str, Callable[[int], Any]]:
    """Of every one a function that makes the k-th step and returns its estimate."""
    import equinox as eqx
    import jax
    import numpy as np

    import aslo_jax as aslo

    from .replay import INDUCTANCE, MAGNET_FLUX, RATE, RESISTANCE, log

    _, u, y, _ = log(2 * CALLS)
    relation = aslo.plants.FluxRelation(RESISTANCE, INDUCTANCE, MAGNET_FLUX)
    observers = {
        "ASLO": aslo.AlgebraicObserver(relation, aslo.LowPass(RATE)),
        "Lifted": aslo.Lifted(relation, 0.01, 0.1),
        "Adaptive": aslo.Adaptive(relation, 0.01, 0.1),
    }

    def loop(step: Any, observer: Any) -> Callable[[int], Any]:
        state = observer.init(y[0], u[0])

        def run(k: int) -> Any:
            nonlocal state
            state, estimate = step(state, u[k - 1], y[k], INTERVAL)
            return np.asarray(estimate.value)

        return run

    found = {}
    for name, observer in observers.items():
        whole = jax.jit(lambda state, u, y, dt, o=observer: o.step(state, u, y, dt))
        _, estimate = whole(observer.init(y[0], u[0]), u[0], y[1], INTERVAL)
        empty = jax.jit(lambda state, u, y, dt, e=estimate: (state, e))
        found[f"{name}, empty"] = loop(empty, observer)
        found[f"{name}, jax.jit"] = loop(whole, observer)
        found[f"{name}, eqx.filter_jit"] = loop(eqx.filter_jit(observer.step), observer)
    return found


def measure() -> dict[str, dict[str, list[int]]]:
    """The nanoseconds of every call of every contender, by both clocks."""
    import gc

    import jax

    jax.config.update("jax_enable_x64", True)
    every, shuffle = contenders(), random.Random(0).shuffle
    for run in every.values():
        for k in range(1, WARM):
            run(k)
    gc.collect()
    gc.freeze()
    gc.disable()
    spent = {name: {clock: [] for clock in CLOCKS} for name in every}
    order, wall, busy = list(every), time.perf_counter_ns, time.process_time_ns
    for first in range(WARM, WARM + CALLS, BLOCK):
        shuffle(order)
        for name in order:
            run, (processor, clock) = every[name], spent[name].values()
            for k in range(first, first + BLOCK):
                begun, begun_busy = wall(), busy()
                run(k)
                processor.append(busy() - begun_busy)
                clock.append(wall() - begun)
    return spent


def quantiles(nanoseconds: list[int]) -> dict[str, tuple[float, float, float]]:
    """Each with the ends of its interval of 95 %, in microseconds."""
    import numpy as np
    from scipy.stats import quantile_test

    x = np.asarray(nanoseconds) / 1e3
    found = {}
    for name, p in QUANTILES.items():
        ends = quantile_test(x, p=p).confidence_interval(0.95)
        found[name] = (float(np.quantile(x, p)), float(ends.low), float(ends.high))
    return found


def main() -> list[str]:
    """Print and keep the figures; return what does not hold."""
    command = [sys.executable, "-m", "benchmarks.latency"]
    root = Path(__file__).parents[1]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=root)
    pinned, figures = json.loads(done.stdout)
    where = "pinned to one" if pinned else "not pinned"
    print(f"One step from Python, float64, microseconds [95 %]; {where}, {timing.load()}")
    head = [f"{q}, {clock}" for clock in CLOCKS for q in QUANTILES]
    print(f"  {'':<26}" + "".join(f"{text:>24}" for text in head) + f"{'over empty':>12}")
    failures = []
    for name, of in figures.items():
        who, _, how = name.partition(", ")
        empty = figures[f"{who}, empty"]["processor"]["median"][0]
        of["ratio"] = of["processor"]["median"][0] / empty
        cells = [of[clock][q] for clock in CLOCKS for q in QUANTILES]
        text = "".join(f"{f'{x:.0f} [{a:.0f}, {b:.0f}]':>24}" for x, a, b in cells)
        print(f"  {name:<26}{text}{of['ratio']:>12.2f}")
        if how == "jax.jit" and of["ratio"] > BOUNDS[who]:
            failures.append(
                f"A step of {who} takes {of['ratio']:.2f} empty calls, more than "
                f"{BOUNDS[who]:g}."
            )
    results.save("latency", {"pinned": pinned, "load": timing.load(), "calls": figures})
    return failures


if __name__ == "__main__":
    alone = pin()
    spent = measure()
    print(
        json.dumps(
            [
                alone,
                {
                    name: {clock: quantiles(x) for clock, x in of.items()}
                    for name, of in spent.items()
                },
            ]
        )
    )
