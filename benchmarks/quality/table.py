"""The run: figures for people, `quality.json`, its tables for the page in `quality.md`, and
what does not hold."""

import json
import sys
import time
from typing import Any

from ..results import FOLDER, save
from .contenders import contenders
from .cost import cost
from .mechanical_table import measured as measured_mechanism
from .mechanisms import regimes as mechanical_regimes
from .operations import operations
from .page import tables
from .regimes import CURRENT, INTERVAL, VOLTAGE, regimes
from .runs import STARTS, VALIDATION, bounds, judged

# Of the bound that knows the parameters.
AT_MOST = {
    "Lifted": {"slow": 1.2, "75 rad/s": 1.1, "reversal": 1.2},
    "ASLO, two rates": {"slow": 1.2, "75 rad/s": 1.05, "reversal": 1.55},
}
# Of the bound that does not, of all errors together and of each single one; where nothing
# turns or changes they cannot be found.
POOLED, SINGLE = 1.15, 1.5

COST = {"Lifted": 1.5, "Adaptive": 2.5}  # of ASLO
CALIBRATED = 0.7, 1.4


def chosen() -> tuple[list[str], bool]:
    """The regimes of the command line, all by default; and whether costs are measured."""
    every = [*regimes(), *mechanical_regimes()]
    given = [b for a, b in zip(sys.argv, sys.argv[1:], strict=False) if a == "--regime"]
    if unknown := set(given) - set(every):
        sys.exit(f"No regime {sorted(unknown)}; there are {every}.")
    return given or every, not given


def said(name: str, figures: dict[str, Any]) -> None:
    """One regime, for people."""
    least = figures["bounds"]
    print(
        f"  {name}: bound {1e3 * least['known']:.4f}, without R and m "
        f"{1e3 * least['unknown']:.4f} mWb, R {100 * least['resistance']:.3f} %"
    )
    for who, f in figures["contenders"].items():
        claimed = "".join(
            f"; {at}calibration {f[at + 'normalised']:.2f}, 95 % covers "
            f"{100 * f[at + 'covered']:.1f} %"
            for at in ("", "wrong ")
            if at + "normalised" in f
        )
        held = f", held {f['held']}" if "held" in f else ""
        each = ", ".join(f"{1e3 * x:.3g}" for x in f["by error"])
        print(
            f"    {who:<16}{1e3 * f['rms']:>9.4f} ({f['rms'] / least['known']:.2f}), "
            f"median {1e3 * f['median']:.4f}; diverged {f['diverged']} of {f['starts']}; "
            f"wrong {1e3 * f['wrong']:.4f} ({each}), of {f['runs']} lost {f['lost']}, "
            f"flagged {f['flagged']}{held}{claimed}; {f['seconds']:.0f} s; {f['gains']}",
            flush=True,
        )


def faults(name: str, figures: dict[str, Any]) -> list[str]:
    found = []
    least, every = figures["bounds"], figures["contenders"]
    for who, limits in AT_MOST.items():
        over = every[who]["rms"] / least["known"]
        if over > limits.get(name, float("inf")):
            found.append(f"{who} is {over:.3f} times the bound, regime {name}.")
    for who in ("Lifted", "Adaptive"):
        if every[who]["diverged"]:
            found.append(f"{who} diverged {every[who]['diverged']} times, regime {name}.")
        for at in ("", "wrong ") if who == "Adaptive" else ("",):
            value = every[who][at + "normalised"]
            if not CALIBRATED[0] < value < CALIBRATED[1]:
                kind = "wrong" if at else "exact"
                found.append(
                    f"The covariance of {who} is not that of its error in the regime "
                    f"{name} with {kind} parameters: {value:.2f}."
                )
    adaptive = every["Adaptive"]
    if not name.startswith("constant"):
        worst = max(adaptive["by error"])
        limits = ("pooled", adaptive["wrong"], POOLED), ("the worst", worst, SINGLE)
        for of, rms, most in limits:
            if (value := rms / least["unknown"]) > most:
                found.append(
                    f"Adaptive with wrong parameters, {of}, is {value:.3f} times the bound "
                    f"with unknown ones, regime {name}."
                )
    elif adaptive["held"] + adaptive["flagged"] < adaptive["runs"]:
        found.append(f"Adaptive is neither held nor flagged in each run, regime {name}.")
    if lost := adaptive["lost"]:
        found.append(f"Adaptive is lost {lost} times without a flag, regime {name}.")
    return found


def main() -> list[str]:
    """Print the table, write `quality.json`; return what does not hold."""
    import jax

    jax.config.update("jax_enable_x64", True)
    path = FOLDER / "quality.json"
    names, costs = chosen()
    figures = json.loads(path.read_text()) if path.exists() else {}
    failures = []
    if set(names) & set(regimes()):
        print(
            f"Flux error (mWb) with {1e3 * CURRENT:g} mA and {VOLTAGE:g} V of noise at "
            f"{1e-3 / INTERVAL:g} kHz, {len(VALIDATION)} seeds; divergences of "
            f"{len(STARTS)}"
        )
    for name in names:
        if name in mechanical_regimes():
            failures += measured_mechanism(name)
            continue
        found: dict[str, Any] = {"bounds": bounds(name), "contenders": {}}
        for who, contender in contenders().items():
            start = time.perf_counter()
            f = judged(name, who, contender)
            f["seconds"] = time.perf_counter() - start
            found["contenders"][who] = f
        figures[name] = found
        save("quality", figures)
        said(name, found)
        failures += faults(name, found)
    if costs:
        figures["cost"] = found = cost()
        figures["operations"] = counts = operations()
        save("quality", figures)
        print("  cost of a row, over that of ASLO: " + str(found))
        print("  operations of a step: " + str(counts))
        for who, most in COST.items():
            if found[who] > most:
                failures.append(f"{who} costs {found[who]:.2f} ASLOs, more than {most:g}.")
    (FOLDER / "quality.md").write_text(tables(figures))
    return failures
