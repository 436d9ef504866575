"""Every benchmark, or those named on the command line."""

import sys

from . import import_time, replay, reversal

BENCHMARKS = {
    "import_time": import_time.main,
    "replay": replay.main,
    "reversal": reversal.main,
}

if __name__ == "__main__":
    names = sys.argv[1:] or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        sys.exit(f"No benchmark {sorted(unknown)}; there are {sorted(BENCHMARKS)}.")
    failures = [failure for name in names for failure in BENCHMARKS[name]()]
    sys.exit("\n".join(["", *failures]) if failures else 0)
