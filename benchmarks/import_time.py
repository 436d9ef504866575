"""How much longer `import aslo_jax` takes than `import diffrax`, in fresh interpreters."""

import os
import statistics
import subprocess
import sys

RUNS = 9
BOUND = 0.2  # seconds above diffrax

_TIMED = """
import time
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""


def seconds_to_import(module: str) -> float:
    """Seconds that importing `module` takes in a fresh interpreter."""
    command = [sys.executable, "-c", _TIMED.format(module=module)]
    # As after an installation, whose modules are bytecode.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, env=environment
    )
    return float(done.stdout)


def main() -> list[str]:
    """Print the medians; return what does not hold."""
    modules = "diffrax", "aslo_jax"
    for module in modules:
        seconds_to_import(module)  # compiles the bytecode, fills the file cache
    runs = [[seconds_to_import(module) for module in modules] for _ in range(RUNS)]
    medians = [statistics.median(column) for column in zip(*runs, strict=True)]
    extra = statistics.median(ours - base for base, ours in runs)
    print(f"Import time, medians of {RUNS} alternating fresh interpreters")
    for module, median in zip(modules, medians, strict=True):
        print(f"  {module:<12}{median:8.3f} s")
    print(f"  {'difference':<12}{extra:8.3f} s   (bound {BOUND} s)")
    if extra <= BOUND:
        return []
    return [f"Importing aslo_jax takes {extra:.3f} s above diffrax, more than {BOUND} s."]
