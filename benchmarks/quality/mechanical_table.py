"""The table of the mechanisms: figures for people, `quality-mechanisms.json`, its tables
for the page in `quality-mechanisms.md`, and what does not hold."""

import json
import time
from typing import Any

from ..results import FOLDER, save
from .mechanical_runs import bounds, contenders, judged
from .mechanisms import mechanisms, regimes
from .operations import counted_observer

AT_MOST = 1.2  # LiftedVelocities, of the bound
CALIBRATED = 0.7, 1.4
NAME = "quality-mechanisms"


def measured(regime: str) -> list[str]:
    """Measure one regime, print and keep its figures; return what does not hold."""
    name, bits = regimes()[regime]
    path = FOLDER / f"{NAME}.json"
    figures = json.loads(path.read_text()) if path.exists() else {}
    found: dict[str, Any] = {"bounds": bounds(name, bits), "contenders": {}}
    least = found["bounds"]
    print(f"  {regime}: bound {least['known']:.3g}, unknown {least['unknown']:.3g}")
    for who, contender in contenders(name, bits).items():
        start = time.perf_counter()
        f = judged(name, bits, who, contender)
        f["seconds"] = time.perf_counter() - start
        f["operations"] = operations(name, bits, who)
        found["contenders"][who] = f
        claimed = "".join(
            f"; {at}calibration {f[at + 'normalised']:.2f}, 95 % covers "
            f"{100 * f[at + 'covered']:.1f} %"
            for at in ("", "wrong ")
            if at + "normalised" in f
        )
        print(
            f"    {who:<26}{f['rms']:.3g} ({f['rms'] / least['known']:.2f}), median "
            f"{f['median']:.3g}; diverged {f['diverged']} of {f['starts']}; wrong "
            f"{f['wrong']:.3g} ({f['wrong'] / least['unknown']:.2f}), flagged "
            f"{f['flagged']} of {f['runs']}{claimed}; {f['operations']} operations; "
            f"{f['seconds']:.0f} s; {f['gains']}",
            flush=True,
        )
    figures[regime] = found
    save(NAME, figures)
    (FOLDER / f"{NAME}.md").write_text(tables(figures))
    return faults(regime, found)


def operations(name: str, bits: int, who: str) -> int:
    """Those of a step in the fused engine."""
    import dataclasses

    import jax.numpy as jnp

    of, contender = mechanisms()[name], contenders(name, bits)[who]
    model = dataclasses.replace(of.system, angles=(False,) * len(of.lengths))
    y = jnp.asarray(of.high)
    gains = (jnp.ones(()) for _ in contender.gains)
    return counted_observer(contender.make(model, y, *gains), model.no_input(y), y)


def faults(regime: str, found: dict[str, Any]) -> list[str]:
    every, least, failures = found["contenders"], found["bounds"], []
    lifted = every["LiftedVelocities"]
    if (over := lifted["rms"] / least["known"]) > AT_MOST:
        failures.append(f"LiftedVelocities is {over:.3f} times the bound, {regime}.")
    for who in ("LiftedVelocities", "AdaptiveVelocities"):
        if every[who]["diverged"]:
            failures.append(f"{who} diverged {every[who]['diverged']} times, {regime}.")
    # Rounding of a slow motion is not white: AdaptiveVelocities claims too much at 12 bits.
    if not CALIBRATED[0] < lifted["normalised"] < CALIBRATED[1]:
        failures.append(
            f"The covariance of LiftedVelocities is not that of its error, {regime}: "
            f"{lifted['normalised']:.2f}."
        )
    if lifted["flagged"] < lifted["runs"]:
        failures.append(f"LiftedVelocities is wrong without a flag, {regime}.")
    return failures


def tables(figures: dict[str, Any]) -> str:
    """Errors with exact parameters, with wrong ones, and what claims are worth."""
    names = list(figures)
    every = list(figures[names[0]]["contenders"])
    head = [["observer", *names], ["---"] * (len(names) + 1)]
    rows = {"known": [*head], "unknown": [*head], "claims": [*head]}
    for key in ("known", "unknown"):
        least = [f"*{figures[n]['bounds'][key]:.3g}*" for n in names]
        rows[key].append(["*bound*", *least])
    for who in every:
        of = [figures[n]["contenders"][who] for n in names]
        least = [figures[n]["bounds"] for n in names]
        known, unknown = [], []
        for f, b in zip(of, least, strict=True):
            lost = f", {f['diverged']} lost" if f["diverged"] else ""
            known.append(f"{f['rms']:.3g} ({f['rms'] / b['known']:.2f}{lost})")
            flagged = f", {100 * f['flagged'] / f['runs']:.0f} % flagged"
            flagged = flagged if f["flagged"] else ""
            unknown.append(f"{f['wrong']:.3g} ({f['wrong'] / b['unknown']:.3g}{flagged})")
        rows["known"].append([who, *known])
        rows["unknown"].append([who, *unknown])
        for at, label in (("", "exact"), ("wrong ", "wrong")):
            if at + "normalised" in of[0]:
                cells = [
                    f"{f[at + 'normalised']:.3g} ({100 * f[at + 'covered']:.1f} %)"
                    for f in of
                ]
                rows["claims"].append([f"{who}, {label} parameters", *cells])
    text = lambda table: "\n".join("| " + " | ".join(row) + " |" for row in table)
    return "\n\n".join(map(text, rows.values())) + "\n"
