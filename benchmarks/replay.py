"""A million samples through the PMSM observer, in float64, beside peers that compute the
same estimate: in NumPy a loop over the samples and a cascade of `lfilter`, and C by hand.

Every contender runs in a fresh process of its own, alone, which also measures its memory.
"""

import importlib.util
import json
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Literal

SAMPLES = 1_000_000
LOOP_SAMPLES = 20_000  # the loop is measured on these and scaled
RUNS = 5
SECONDS, RATIO, GIGABYTES = 3.0, 20.0, 1.5  # the bounds

RESISTANCE, INDUCTANCE, MAGNET_FLUX, POLE_PAIRS = 8.875, 40.03e-3, 0.2086, 5
INTERVAL, RATE = 1e-4, 20.0
SETTINGS = {"resistance": RESISTANCE, "inductance": INDUCTANCE, "lam": RATE}


def log(samples: int):
    """A run at 8 to 32 rad/s (mechanical) with 1 A: t, held u, sampled y, true flux."""
    import numpy as np

    def signals(t):
        angle = POLE_PAIRS * (20.0 * t - 24.0 * np.cos(0.5 * t))
        current = 1.0 + 0.3 * np.sin(1.7 * t)
        y = current[:, None] * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        magnet = MAGNET_FLUX * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return y, INDUCTANCE * y + magnet

    t = INTERVAL * np.arange(samples)
    y, flux = signals(t)
    # The voltage held over an interval is its mean: that of flux' exactly, that of the
    # current by Simpson's rule.
    middle, _ = signals(t[:-1] + 0.5 * INTERVAL)
    mean = (y[:-1] + 4.0 * middle + y[1:]) / 6.0
    u = np.zeros_like(y)
    u[:-1] = np.diff(flux, axis=0) / INTERVAL + RESISTANCE * mean
    return t, u, y, flux


def oracles() -> ModuleType:
    """The peers: the tests' own oracles."""
    path = Path(__file__).parents[1] / "tests" / "oracles.py"
    spec = importlib.util.spec_from_file_location("oracles", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def aslo(t, u, y, engine: Literal["fused", "scan"] = "scan"):
    import jax

    import aslo_jax

    jax.config.update("jax_enable_x64", True)
    relation = aslo_jax.plants.FluxRelation(RESISTANCE, INDUCTANCE)
    observer = aslo_jax.AlgebraicObserver(relation, aslo_jax.LowPass(RATE))
    return lambda: (
        jax.block_until_ready(aslo_jax.replay(observer, t, u, y, engine=engine)).value
    )


def fused(t, u, y):
    return aslo(t, u, y, "fused")


def cascade(t, u, y):
    replay_cascade = oracles().replay_cascade
    return lambda: replay_cascade(t, u, y, **SETTINGS)


def loop(t, u, y):
    replay_loop = oracles().replay_loop
    return lambda: replay_loop(t, u, y, **SETTINGS).flux


def by_hand(t, u, y):
    """`replay.c`, compiled by gcc."""
    import ctypes

    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "replay.so"
        flags = ["-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC"]
        source = Path(__file__).with_name("replay.c")
        subprocess.run(["gcc", *flags, "-o", str(path), str(source), "-lm"], check=True)
        library = ctypes.CDLL(str(path))
    decay, left, right = oracles().hold_weights(RATE, INTERVAL)
    settings = INTERVAL, RESISTANCE, INDUCTANCE, RATE, decay, left / RATE, right / RATE
    settings = *settings, sys.float_info.epsilon**0.75
    inputs = [np.ascontiguousarray(x) for x in (u, y)]

    def run():
        outputs = np.empty((len(t), 2)), np.empty(len(t))
        library.replay(
            ctypes.c_long(len(t)),
            *map(ctypes.c_double, settings),
            *(ctypes.c_void_p(x.ctypes.data) for x in (*inputs, *outputs)),
        )
        return outputs[0]

    return run


CONTENDERS = {
    "aslo": (aslo, SAMPLES, RUNS),
    "fused": (fused, SAMPLES, RUNS),
    "cascade": (cascade, SAMPLES, RUNS),
    "loop": (loop, LOOP_SAMPLES, 3),
}
if shutil.which("gcc"):
    CONTENDERS["C"] = (by_hand, SAMPLES, RUNS)


def contend(name: str, folder: str) -> None:
    """In a process of its own: run a contender, save its estimate, print its figures."""
    import numpy as np

    contender, samples, runs = CONTENDERS[name]
    t, u, y, flux = log(samples)
    run, value, seconds = contender(t, u, y), None, []
    for _ in range(1 + runs):
        start = time.perf_counter()
        value = run()
        seconds.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    settled = t > 0.1
    error = np.abs(np.asarray(value) - flux)[settled].max()
    np.save(Path(folder) / f"{name}.npy", np.asarray(value))
    figures = {
        "first": seconds[0],
        "median": statistics.median(seconds[1:]),
        "samples": samples,
        "gigabytes": peak * (1 if sys.platform == "darwin" else 1024) / 1e9,
        "error": float(error),
    }
    print(json.dumps(figures))


def measure(name: str, folder: str) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.replay", name, folder]
    root = Path(__file__).parents[1]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=root)
    return json.loads(done.stdout)


def main() -> list[str]:
    """Check that the estimates agree, print the table; return what does not hold."""
    with tempfile.TemporaryDirectory() as folder:
        # The parent stays small until here: a child inherits its peak memory on Linux.
        figures = {name: measure(name, folder) for name in CONTENDERS}
        import numpy as np

        values = {name: np.load(Path(folder) / f"{name}.npy") for name in CONTENDERS}
    scaled = {k: f["median"] * SAMPLES / f["samples"] for k, f in figures.items()}
    ours = figures["aslo"]
    print(f"Replay of {SAMPLES:,} samples, PMSM least squares, float64; medians")
    print(f"{'first run':>22}{'median':>10}{'ratio':>8}{'peak':>9}{'flux error':>13}")
    for name, f in figures.items():
        print(
            f"  {name:<10}{f['first']:>8.2f} s{scaled[name]:>8.2f} s"
            f"{scaled[name] / scaled['aslo']:>8.1f}{f['gigabytes']:>6.2f} GB"
            f"{f['error']:>10.1e} Wb"
        )
    print(f"  loop: median of {LOOP_SAMPLES:,} samples, scaled to {SAMPLES:,}; the cascade")
    print("  has no certificate and no coasting; first run: with tracing, compilation.")
    failures = []
    start = round(0.05 / INTERVAL)
    for name, value in values.items():
        piece = slice(start, len(value))
        difference = np.abs(values["aslo"][piece] - value[piece]).max()
        if not difference <= 1e-10 * MAGNET_FLUX:
            failures.append(
                f"The estimates of aslo and {name} differ by {difference:.1e} Wb."
            )
    if not ours["median"] <= SECONDS:
        failures.append(f"Replay takes {ours['median']:.2f} s, more than {SECONDS} s.")
    if not scaled["loop"] >= RATIO * scaled["aslo"]:
        ratio = scaled["loop"] / scaled["aslo"]
        failures.append(f"Replay is {ratio:.1f} times the loop, less than {RATIO}.")
    if not ours["gigabytes"] <= GIGABYTES:
        failures.append(
            f"Replay takes {ours['gigabytes']:.2f} GB, more than {GIGABYTES} GB."
        )
    return failures


if __name__ == "__main__":
    contend(*sys.argv[1:])
