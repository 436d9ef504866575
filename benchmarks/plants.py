"""Plants that are models: their derived observers beside copies of the plant, on the noise
of the ready-made studies. `plants.json` and `plants.md` in the folder of the results.

Every observer that has gains has had the same search on training seeds (its results, of
`python -m benchmarks.gains NAME`, stand in the studies), and is judged on fresh ones; the
Kalman filter of the relation has none, and is told of the noise. The bound is that of
Cramér and Rao, for observers that know as much. `--wrong`: besides with every parameter 2 %
off, for which all are tuned anew.
"""

import copy
import json
import sys
import time
import tomllib
from importlib.resources import files
from typing import Any

from .page import table
from .results import FOLDER, save

SAMPLES, SEED = 256, 77  # fresh ones
BOUNDED = 32
WRONG = 0.02  # relative deviation of every parameter
BELOW = 0.85  # of the bound: no observer gets there, but by chance
OBSERVERS = ("ASLO", "A-ASLO", "lifted Kalman", "extended Kalman", "Luenberger")
LOST = 10.0  # times the median of the others: a trajectory that is lost


def names() -> list[str]:
    """The machines of the command line, all by default."""
    from aslo_jax.machines._modelled import STUDIES

    every = [study.kind for study in STUDIES]
    given = [b for a, b in zip(sys.argv, sys.argv[1:], strict=False) if a == "--only"]
    if unknown := set(given) - set(every):
        sys.exit(f"No machine {sorted(unknown)}; there are {every}.")
    return given or every


def content(name: str, *, wrong: bool) -> dict[str, Any]:
    """A study's file, its plant's known parameters spread where they are `wrong`."""
    from aslo_jax.study._config import configure

    text = (files("aslo_jax.study") / "configs" / f"{name}.toml").read_text("utf-8")
    found = tomllib.loads(text)
    if wrong:
        plant: Any = configure(copy.deepcopy(found)).experiment.plant
        for parameter in plant.parameters():
            if parameter not in plant.unknown:
                found["spread"][f"wrong_{parameter}"] = {
                    "where": f"plant.{parameter}",
                    "distribution": "normal",
                    "mean": 1.0,
                    "deviation": WRONG,
                    "relative": True,
                }
    return found


def judged(given: dict[str, Any]) -> dict[str, Any]:
    """The errors of the observers of a study on fresh samples, and the bound: of every
    entry, and of all over their scales."""
    import jax
    import numpy as np

    from aslo_jax import study
    from aslo_jax.study._config import configure
    from aslo_jax.study._reference import bound_of, unknown_in

    found, key = configure(copy.deepcopy(given)), jax.random.key(SEED)
    spread = found.spread
    data = study.run(found.experiment, spread, samples=SAMPLES, key=key, **found.settings)
    after = given["metrics"]["rms"]["after"]
    scale = np.asarray(found.scale)
    unknown = unknown_in(found.experiment, spread) or None
    bound = bound_of(
        found.experiment,
        spread,
        found.steps,
        key=key,
        trajectories=BOUNDED,
        unknown=unknown,
    )
    least = bound.variance[:, bound.t >= after].mean(axis=(0, 1))

    def summary(squares: Any) -> dict[str, Any]:
        return {
            "entries": np.sqrt(squares).tolist(),
            "all": float(np.sqrt((squares / scale**2).sum())),
        }

    rows = {}
    for name in map(str, data.observer.values):
        rms = np.asarray(data["rms"].sel(observer=name))
        rms = np.where(np.isfinite(rms), rms, 1e12)
        size = np.linalg.norm(rms / scale, axis=1)
        lost = size > LOST * np.median(size)
        rows[name] = summary((rms**2).mean(axis=0))
        rows[name] |= {"median": float(np.median(size)), "lost": int(lost.sum())}
    return {
        "entries": found.entries,
        "units": [*_units(given)],
        "bound": summary(least),
        "observers": rows,
    }


def _units(given: dict[str, Any]) -> Any:
    from aslo_jax.machines import studies

    return studies()[given["machine"]["kind"]].units


def measure(name: str, *, wrong: bool) -> dict[str, Any]:
    from . import gains

    given = content(name, wrong=wrong)
    if wrong:
        given["observers"] |= gains.searched(name, copy.deepcopy(given))
    return judged(given) | {"gains": given["observers"]}


def rows(figures: dict[str, Any]) -> list[list[str]]:
    """A row for every entry of the hidden part of every machine."""
    found = []
    for name, f in figures.items():
        for k, entry in enumerate(f["entries"]):
            unit = f["units"][k]
            what = f"{entry} ({unit})" if unit not in ("", "1") else entry
            cells = [name if k == 0 else "", what, f"{f['bound']['entries'][k]:.2g}"]
            for who in OBSERVERS:
                row = f["observers"].get(who)
                value = None if row is None else row["entries"][k]
                cells.append("" if value is None else f"{value:.2g}")
            found.append(cells)
    return found


def tables(figures: dict[str, Any]) -> str:
    """Those of the page."""
    head = ("machine", "what", "bound", *OBSERVERS)
    titles = {
        "exact": "Parameters known:",
        "wrong": f"Every parameter {100 * WRONG:g} % off:",
    }
    parts = [
        f"{title}\n\n{table(head, rows(figures[which]))}\n"
        for which, title in titles.items()
        if which in figures
    ]
    return "\n".join(parts)


def said(name: str, which: str, f: dict[str, Any]) -> None:
    least = f["bound"]["all"]
    each = ", ".join(
        f"{who} {r['all']:.3g} ({r['all'] / least:.2f}"
        + (f", lost {r['lost']}" if r["lost"] else "")
        + ")"
        for who, r in f["observers"].items()
    )
    print(f"  {name}, {which}: bound {least:.3g}; {each}; {f['seconds']:.0f} s", flush=True)


def faults(name: str, f: dict[str, Any]) -> list[str]:
    """Whoever is below the bound uses what it should not know."""
    least = f["bound"]["all"]
    return [
        f"{name}: {who} is {row['all'] / least:.2f} times the bound."
        for who, row in f["observers"].items()
        if row["all"] < BELOW * least
    ]


def main() -> list[str]:
    """Print the figures, write the tables; return what does not hold."""
    import jax

    jax.config.update("jax_enable_x64", True)
    path = FOLDER / "plants.json"
    figures = json.loads(path.read_text()) if path.exists() else {}
    print(f"Rms errors over their scales, over the bound, of {SAMPLES} fresh samples:")
    failures = []
    which_ones = ("exact", "wrong") if "--wrong" in sys.argv else ("exact",)
    for name in names():
        for which in which_ones:
            start = time.perf_counter()
            f = measure(name, wrong=which == "wrong")
            f["seconds"] = time.perf_counter() - start
            figures.setdefault(which, {})[name] = f
            save("plants", figures)
            said(name, which, f)
            if which == "exact":
                failures += faults(name, f)
    (FOLDER / "plants.md").write_text(tables(figures))
    return failures
