"""The figures of a run as tables of Markdown, for `docs/performance.md`:
`python -m benchmarks.page` prints what the folder of the results holds."""

import json
from collections.abc import Iterable
from typing import Any

from . import pmsm, results


def table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    cells = [list(head), *(list(map(str, row)) for row in rows)]
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    lines.insert(1, "|" + "---|" * len(cells[0]))
    return "\n".join(lines)


def headline(figures: dict[str, Any]) -> str:
    rows = []
    for r in figures["rows"]:
        register = r.get("register", figures["register"])
        fused = pmsm.speed(figures, "fused", r["noisy"], r["threads"], register)
        errors = " ".join(f"{e:.0e}" for e in r["errors"])
        noise = "yes" if r["noisy"] else "no"
        threads = 1 if r["engine"].startswith("SciPy") else r["threads"]
        speed, ratio = f"{r['speed']:.3g}", f"{fused / r['speed']:.3g}"
        rows.append([r["engine"], register, noise, threads, speed, ratio, errors])
    head = (
        "engine",
        "bytes",
        "noise",
        "threads",
        "million steps/s",
        "fused over it",
        "errors (Wb)",
    )
    return table(head, rows)


def systems(figures: dict[str, Any]) -> str:
    rows = []
    for name, found in figures.items():
        fused = {r["noisy"]: r["speed"] for r in found if r["engine"] == "fused"}
        for r in found:
            noise, errors = (
                "yes" if r["noisy"] else "no",
                " ".join(f"{e:.0e}" for e in r["errors"]),
            )
            ratio = f"{fused[r['noisy']] / r['speed']:.3g}"
            rows.append([name, r["engine"], noise, f"{r['speed']:.3g}", ratio, errors])
    head = "plant", "engine", "noise", "million steps/s", "fused over it", "errors"
    return table(head, rows)


def peers(figures: dict[str, Any]) -> str:
    rows = [
        [name, f.get("why") or f"{f['speed']:.2g}", f.get("what", "")]
        for name, f in figures.items()
    ]
    return table(("project", "million steps/s", "work"), rows)


def felt(figures: dict[str, Any]) -> str:
    rows = []
    for name, f in figures.items():
        bound = "" if f["bound"] is None else f"{f['bound']:.2g}"
        parts = f.get("shares", {})
        split = ", ".join(f"{k} {s:.2g}" for k, s in parts.items())
        rows.append([name, f"{f['cpu']:.2g}", bound, f"{f['memory']:.0f}", split])
    return table(("what", "processor time (s)", "at most", "memory (MB)", "of which"), rows)


TABLES = {"felt": felt, "pmsm": headline, "systems": systems, "peers": peers}

if __name__ == "__main__":
    for name, of in TABLES.items():
        path = results.FOLDER / f"{name}.json"
        if path.exists():
            print(f"\n{name}\n\n{of(json.loads(path.read_text()))}")
