"""Which columns of a file are those of a log, and what to say where one is missing."""

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path

from ._log_files import LogError
from ._log_signals import Signals


def checked_mapping(columns: Mapping[str, str], signals: Signals) -> dict[str, str]:
    for name in columns:
        if name not in signals.names:
            close = _closest(name, signals.names)
            hint = f"; did you mean `{close[0]}`?" if close else ""
            raise LogError(
                f"Argument `columns` (option --column) must name one of "
                f"{', '.join(signals.names)}, but got `{name}`{hint}"
            )
    return dict(columns)


def select(
    path: Path,
    signals: Signals,
    names: Mapping[str, str],
    mapped: Mapping[str, str],
    available: list[str],
) -> dict[str, str]:
    """The columns to read, by our names: those required, and of the others those there."""
    chosen = {}
    lacking = []
    some = any(names[name] in available for name in signals.optional)
    for name, actual in names.items():
        count = available.count(actual)
        if count > 1:
            places = [str(k + 1) for k, other in enumerate(available) if other == actual]
            raise LogError(
                f"{path} has {count} columns called `{actual}` (columns "
                f"{', '.join(places)}); rename all but one."
            )
        needed = name in signals.required or name in mapped
        if count == 1:
            chosen[name] = actual
        elif needed or (some and name in signals.optional):
            lacking.append(name)
    if lacking:
        _refuse_missing(path, lacking, signals, names, mapped, available)
    sources = list(chosen.values())
    for name, actual in chosen.items():
        if sources.count(actual) > 1:
            both = " and ".join(f"`{k}`" for k, v in chosen.items() if v == actual)
            name = next(k for k in mapped if chosen.get(k) == actual)
            raise LogError(
                f"Column `{actual}` of {path} is read as {both}, where it can be only one; "
                f"map `{name}` to another column."
            )
    return chosen


def _refuse_missing(
    path: Path,
    lacking: list[str],
    signals: Signals,
    names: Mapping[str, str],
    mapped: Mapping[str, str],
    available: list[str],
) -> None:
    if available and all(_is_number(name) for name in available):
        raise LogError(
            f"The first line of {path} holds numbers, but it must name the columns; add a "
            f"header line such as {','.join(signals.required)}."
        )
    free = [name for name in available if name not in names.values()]
    hints = []
    for name in lacking:
        # What the user called it says more than what we do.
        close = [*_closest(names[name], free), *_closest(name, free)]
        if close and name in mapped:
            others = ", ".join(f"`{other}`" for other in dict.fromkeys(close))
            hints.append(f"--column {name}={close[0]} (close to it: {others})")
        elif close:
            free.remove(close[0])
            hints.append(f"--column {name}={close[0]}")
    columns = ", ".join(f"`{names[name]}`" for name in lacking)
    plural = "s" if len(lacking) > 1 else ""
    if hints:
        remedy = f"perhaps it goes by another name: {' '.join(hints)}"
    else:
        remedy = f"if it goes by another name, map it: --column {lacking[0]}=NAME"
    if all(name in signals.optional and name not in mapped for name in lacking):
        remedy += f"; or give none of {', '.join(signals.optional)}"
    has = ", ".join(f"`{name}`" for name in available) or "none"
    raise LogError(
        f"{path} has no column{plural} {columns}; {remedy} (in Python, `columns=`). "
        f"Its columns: {has}."
    )


def _closest(name: str, candidates: Iterable[str]) -> list[str]:
    """Up to three of the `candidates` that are much like `name`, the closest first."""

    def plain(text: str) -> str:
        return "".join(c for c in text.lower() if c.isalnum())

    by_plain = {plain(candidate): candidate for candidate in candidates}
    close = difflib.get_close_matches(plain(name), by_plain, n=3, cutoff=0.5)
    if not close and name == "t":
        close = [text for text in by_plain if text.startswith(("t", "sec"))][:1]
    return [by_plain[text] for text in close]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
