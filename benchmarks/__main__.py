"""Every benchmark, or those named on the command line. `--quick`: shorter ones of `pmsm`,
`continuous`, `tuning` and `calibration`; `--install`: environments for `peers` that need
their own; `--regime NAME`: of `quality`, that one alone; `--only NAME`: of `plants`, that
machine; `--wrong`: `plants` with wrong parameters, too."""

import functools
import sys

from . import (
    ablation,
    calibration,
    compile_time,
    continuous,
    explore,
    felt,
    import_time,
    latency,
    peers,
    plants,
    pmsm,
    quality,
    replay,
    reversal,
    soak,
    switching,
    systems,
    tuning,
    varying,
    verdict,
)

NAMED = {"--regime", "--only"}  # followed by a name
FLAGS = {"--quick", "--install", "--wrong", *NAMED}
quick = "--quick" in sys.argv
BENCHMARKS = {
    "felt": felt.main,
    "explore": explore.main,
    "import_time": import_time.main,
    "latency": latency.main,
    "compile_time": compile_time.main,
    "quality": quality.main,
    "replay": replay.main,
    "reversal": reversal.main,
    "switching": switching.main,
    "verdict": verdict.main,
    "calibration": functools.partial(calibration.main, quick),
    "systems": systems.main,
    "plants": plants.main,
    "continuous": functools.partial(continuous.main, quick),
    "soak": soak.main,
    "ablation": ablation.main,
    "peers": functools.partial(peers.main, "--install" in sys.argv),
    "pmsm": functools.partial(pmsm.main, quick),
    "tuning": functools.partial(tuning.main, quick),
    "varying": varying.main,
}

if __name__ == "__main__":
    words = [
        word
        for before, word in zip(sys.argv, sys.argv[1:], strict=False)
        if word not in FLAGS and before not in NAMED
    ]
    names = words or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        sys.exit(f"No benchmark {sorted(unknown)}; there are {sorted(BENCHMARKS)}.")
    failures = [failure for name in names for failure in BENCHMARKS[name]()]
    sys.exit("\n".join(["", *failures]) if failures else 0)
