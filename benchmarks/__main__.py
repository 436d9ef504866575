"""Every benchmark, or those named on the command line. `--quick`: shorter ones of `pmsm`,
`tuning` and `calibration`; `--install`: environments for `peers` that need their own."""

import functools
import sys

from . import (
    ablation,
    calibration,
    compile_time,
    felt,
    import_time,
    peers,
    pmsm,
    quality,
    replay,
    reversal,
    switching,
    systems,
    tuning,
    verdict,
)

FLAGS = {"--quick", "--install"}
quick = "--quick" in sys.argv
BENCHMARKS = {
    "felt": felt.main,
    "import_time": import_time.main,
    "compile_time": compile_time.main,
    "quality": quality.main,
    "replay": replay.main,
    "reversal": reversal.main,
    "switching": switching.main,
    "verdict": verdict.main,
    "calibration": functools.partial(calibration.main, quick),
    "systems": systems.main,
    "ablation": ablation.main,
    "peers": functools.partial(peers.main, "--install" in sys.argv),
    "pmsm": functools.partial(pmsm.main, quick),
    "tuning": functools.partial(tuning.main, quick),
}

if __name__ == "__main__":
    names = [name for name in sys.argv[1:] if name not in FLAGS] or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        sys.exit(f"No benchmark {sorted(unknown)}; there are {sorted(BENCHMARKS)}.")
    failures = [failure for name in names for failure in BENCHMARKS[name]()]
    sys.exit("\n".join(["", *failures]) if failures else 0)
