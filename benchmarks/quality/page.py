"""The tables of `docs/quality.md`, in Markdown, from `quality.json`."""

from typing import Any


def tables(figures: dict[str, Any]) -> str:
    """Of the regimes that have been run: errors with exact parameters, errors with wrong
    ones, and what the claimed deviations are worth."""
    names = [name for name in figures if isinstance(figures[name].get("bounds"), dict)]
    if not names:
        return ""
    every = list(figures[names[0]]["contenders"])
    of = lambda name, who: figures[name]["contenders"][who]
    exact = [["observer", *names], ["---"] * (len(names) + 1)]
    exact.append(["*bound*", *(f"*{_mwb(figures[n]['bounds']['known'])}*" for n in names)])
    for who in every:
        cells = []
        for name in names:
            f = of(name, who)
            over = f["rms"] / figures[name]["bounds"]["known"]
            lost = f", {f['diverged']} lost" if f["diverged"] else ""
            cells.append(f"{_mwb(f['rms'])} ({over:.2f}{lost})")
        exact.append([who, *cells])
    wrong = [["observer", *names], ["---"] * (len(names) + 1)]
    unknown = [f"*{_mwb(figures[n]['bounds']['unknown'])}*" for n in names]
    wrong.append(["*bound, parameters unknown*", *unknown])
    for who in every:
        wrong.append([who, *(_mwb(of(n, who)["wrong"]) for n in names)])
    for label, key in (
        ("lost without a flag", "lost"),
        ("flagged in the last half second", "flagged"),
    ):
        counts = [f"{of(n, 'Adaptive')[key]} of {of(n, 'Adaptive')['runs']}" for n in names]
        wrong.append([f"Adaptive, {label}", *counts])
    claims = [["observer", *names], ["---"] * (len(names) + 1)]
    for who, at, label in (
        ("Lifted", "", "exact parameters"),
        ("Adaptive", "", "exact parameters"),
        ("Adaptive", "wrong ", "wrong parameters"),
    ):
        cells = [_worth(of(n, who), at) for n in names]
        claims.append([f"{who}, {label}", *cells])
    return "\n\n".join(_rows(table) for table in (exact, wrong, claims)) + "\n"


def _worth(figures: dict[str, Any], at: str) -> str:
    covered = 100 * figures[at + "covered"]
    return f"{figures[at + 'normalised']:.2f} ({covered:.1f} %)"


def _mwb(x: float) -> str:
    return f"{1e3 * x:.3g}"


def _rows(table: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in table)
