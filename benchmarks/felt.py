"""What a user waits for at the command line, in processor time of whole processes: help,
estimates of logs of 8,000 to 10 million rows, the report of a study."""

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from . import results
from .timing import load

RUNS = 5
COMMAND = [sys.executable, "-m", "aslo_jax"]
DATA = Path(str(files("aslo_jax") / "data"))
MACHINE = str(DATA / "motor.toml")
HELP = 0.4  # s above `import typer`
LOGS = {10**6: (RUNS, 5.5), 10**7: (1, None)}  # rows: runs, seconds
MEMORY, PIECE = 1000.0, 10**5  # MB, rows
REPORT, SAMPLES = 3.0, 256  # s

# In which part of a process its time goes: XLA tells of every program that it compiles, the
# fused engine compiles in `Program._kernels`.
_SHARES = """
import sys, time

start = time.process_time()
spent = dict(xla=0.0, fused=0.0)
from jax import monitoring

monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **about: spent.update(xla=spent["xla"] + seconds)
    if name == "/jax/core/compile/backend_compile_duration"
    else None
)
import aslo_jax.cli._running
from aslo_jax.engines._fused import program

imported = time.process_time() - start
plain = program.Program._kernels.func


def timed(self):
    begun = time.process_time()
    try:
        return plain(self)
    finally:
        spent["fused"] += time.process_time() - begun


program.Program._kernels.func = timed
from aslo_jax.cli import main

try:
    main(sys.argv[1:])
except SystemExit:
    pass
whole = time.process_time()
compiled = spent["xla"] + spent["fused"]
print("shares", start + imported, compiled, whole - start - imported - compiled)
"""


def measured(command: list[str], refused: bool = False) -> tuple[float, float, float]:
    """Processor time (s), time (s) and largest memory (MB) of a process."""
    begun = time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if bool(process.returncode) is not refused:
        raise RuntimeError(f"{' '.join(command)} left with {process.returncode}")
    unit = 1e6 if sys.platform == "darwin" else 1e3
    spent = usage.ru_utime + usage.ru_stime
    return spent, time.perf_counter() - begun, usage.ru_maxrss / unit


def median(command: list[str], runs: int = RUNS, **settings: Any) -> dict[str, float]:
    found = [measured(command, **settings) for _ in range(runs)]
    columns = zip(*found, strict=True)
    cpu, wall, memory = (statistics.median(column) for column in columns)
    return {"cpu": cpu, "wall": wall, "memory": memory}


def shares(command: list[str]) -> dict[str, float]:
    """Seconds of import, of compilation and of everything else."""
    done = subprocess.run(
        [sys.executable, "-c", _SHARES, *command],
        check=True,
        capture_output=True,
        text=True,
    )
    (line,) = re.findall("^shares (.*)$", done.stdout, re.MULTILINE)
    return dict(zip(("import", "compile", "run"), map(float, line.split()), strict=True))


def motor_log(first: int, rows: int) -> dict[str, np.ndarray]:
    """Rows from the `first` on of a motor at a speed that varies, with its truth: steady
    currents in the rotor's frame, voltages whose means are Simpson's."""
    R, L, m, current, h = 8.875, 40.03e-3, 0.2086, 1.5, 2e-4
    t = h * np.arange(first, first + rows)
    turned = lambda t: 270.0 * t - 40.0 / 0.7 * np.cos(0.7 * t)
    circle = lambda a: np.stack([np.cos(a), np.sin(a)])
    i = lambda t: current * circle(turned(t) + 0.5 * np.pi)
    flux = lambda t: m * circle(turned(t)) + L * i(t)
    mean = (i(t) + 4.0 * i(t + 0.5 * h) + i(t + h)) / 6.0
    u = R * mean + (flux(t + h) - flux(t)) / h
    columns = {"t": t}
    for name, x in (("u", u), ("i", i(t)), ("flux", flux(t))):
        columns |= {f"{name}_alpha": x[0], f"{name}_beta": x[1]}
    return columns | {"theta_electrical": turned(t)}


def _estimate(log: Path, folder: Path) -> list[str]:
    out = str(folder / f"estimate{log.suffix}")
    return ["estimate", str(log), "--machine", MACHINE, "--out", out]


def main() -> list[str]:
    """Print and keep the medians; return what does not hold."""
    figures: dict[str, Any] = {}
    failures: list[str] = []

    def row(name: str, found: dict[str, float], bound: float | None, **more: Any) -> None:
        figures[name] = found | more | {"bound": bound}
        text = "" if bound is None else f"   (bound {bound:.3g} s)"
        print(f"  {name:<34}{found['cpu']:8.2f} s{found['memory']:8.0f} MB{text}")
        if bound is not None and found["cpu"] > bound:
            failures.append(f"{name} takes {found['cpu']:.2f} s, more than {bound:.3g} s.")

    print(f"Processor time of whole processes, medians of {RUNS}; {load()}")
    base = median([sys.executable, "-c", "import typer"])
    row("import typer", base, None)
    for option, refused in (("--help", False), ("--version", False), ("--wrong", True)):
        found = median([*COMMAND, option], refused=refused)
        row(f"aslo-jax {option}", found, base["cpu"] + HELP)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        _logs(folder, row, failures)
        _report(folder, row)
    results.save("felt", figures)
    return failures


def _logs(folder: Path, row: Callable[..., None], failures: list[str]) -> None:
    from aslo_jax.logs import TableWriter

    log = DATA / "pmsm_log.csv"
    command = _estimate(log, folder)
    parts = shares(command)
    row("estimate, 8,000 rows", median([*COMMAND, *command]), 3.0, shares=parts)
    print("    " + ", ".join(f"{name} {s:.2f} s" for name, s in parts.items()))
    for rows, (runs, bound) in LOGS.items():
        for suffix in (".csv", ".parquet"):
            path = folder / f"log{suffix}"
            # In pieces: a process starts with the memory of the one that starts it.
            with TableWriter(path) as writer:
                for first in range(0, rows, PIECE):
                    writer.write(motor_log(first, PIECE))
            found = median([*COMMAND, *_estimate(path, folder)], runs)
            name = f"estimate, {rows:.0e} rows, {suffix[1:]}"
            row(name, found, bound)
            if found["memory"] > MEMORY:
                failures.append(
                    f"{name} takes {found['memory']:.0f} MB, more than {MEMORY:.0f} MB."
                )
            path.unlink()


def _report(folder: Path, row: Callable[..., None]) -> None:
    """What a study takes longer for its report."""
    study = ["study", "pmsm", "--samples", str(SAMPLES), "-q", "--out"]
    found: dict[str, list[float]] = {"--report": [], "--no-report": []}
    for k in range(3):
        for option, spent in found.items():
            command = [*COMMAND, *study, str(folder / f"{option}{k}"), option]
            spent.append(measured(command)[0])
    whole, alone = (statistics.median(spent) for spent in found.values())
    parts = {"study": alone}
    found_here = {"cpu": whole - alone, "memory": 0.0}
    row(f"report of {SAMPLES} samples", found_here, REPORT, shares=parts)
