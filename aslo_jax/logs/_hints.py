"""What to say where a column is missing: options that work when they are pasted."""

import difflib
import shlex
from collections.abc import Iterable, Mapping
from typing import NoReturn

from ._error import LogError
from ._frame import ANGLE, COMPONENTS, Frame
from ._head import Head
from ._names import kinds_of, means, plain
from ._signals import Signals
from ._source import Source


def refuse_missing(
    source: Source,
    heads: list[Head],
    lacking: list[str],
    signals: Signals,
    mapped: Mapping[str, str],
    frame: Frame,
    taken: set[str],
) -> NoReturn:
    """Refuse a file without the columns `lacking`; those `taken` are others of ours."""
    path = source.path
    if heads and all(_is_number(head.name) for head in heads):
        raise LogError(
            f"The first line of {path} holds numbers, but it must name the columns; add a "
            f"header line such as {','.join(signals.required)}."
        )
    columns = ", ".join(f"`{mapped.get(name, name)}`" for name in lacking)
    plural = "s" if len(lacking) > 1 else ""
    remedy, python = _another_frame(heads, lacking, frame), "frame"
    if not remedy:
        remedy, python = _other_names(heads, lacking, mapped, taken), "columns"
    if all(name in signals.optional and name not in mapped for name in lacking):
        remedy += f"; or give none of {', '.join(signals.optional)}"
    has = ", ".join(f"`{head.name}`" for head in heads) or "none"
    unusable = "".join(f" `{name}` {why}." for name, why in source.unusable.items())
    raise LogError(
        f"{path} has no column{plural} {columns}; {remedy} (in Python, `{python}=`). Its "
        f"columns: {has}.{unusable}"
    )


def _another_frame(heads: list[Head], lacking: list[str], frame: Frame) -> str:
    """The option for the frame that the columns seem to be in, if all of a vector are
    there."""
    stems = {name.rpartition("_")[0] for name in lacking if "_" in name}
    for name, ends in COMPONENTS.items():
        needed = [f"{stem}_{end}" for stem in stems for end in ends[:2]]
        there = [any(means(new, head.last, head.unit) for head in heads) for new in needed]
        if name == frame.name or not needed or not all(there):
            continue
        option = f"--frame {name}"
        if name == "dq":
            angles = [head.name for head in heads if head.kind == "angle"]
            option += f" --angle {shlex.quote(angles[0]) if angles else 'COLUMN'}"
        words = {"dq": "d and q", "abc": "phases", "alpha-beta": "alpha and beta"}
        return f"its columns look like {words[name]}: {option}"
    return ""


def _other_names(
    heads: list[Head], lacking: list[str], mapped: Mapping[str, str], taken: set[str]
) -> str:
    free = [head for head in heads if head.name not in taken]
    hints = []
    for name in lacking:
        kinds = kinds_of(name)
        fitting = [h for h in free if not (h.kind and kinds) or h.kind in kinds]
        names = {h.base: h.name for h in fitting}
        # What the user called it says more than what we do.
        close = closest(mapped.get(name, name), names) + closest(name, names)
        if not close and name == "t":
            close = [head.base for head in fitting if head.kind == "time"]
        if name == ANGLE:
            close += [head.base for head in fitting if head.kind == "angle"]
        close = [names[base] for base in dict.fromkeys(close)]
        if not close:
            continue
        hint = _option(name, close[0])
        if name in mapped:
            hint += f" (close to it: {', '.join(f'`{other}`' for other in close)})"
        else:
            free = [head for head in free if head.name != close[0]]
        hints.append(hint)
    if hints:
        return f"perhaps it goes by another name: {' '.join(hints)}"
    return f"if it goes by another name, map it: {_option(lacking[0], 'NAME')}"


def _option(name: str, value: str) -> str:
    if name == ANGLE:
        return f"--angle {shlex.quote(value)}"
    return f"--column {shlex.quote(f'{name}={value}')}"


def closest(name: str, candidates: Iterable[str]) -> list[str]:
    """Up to three of the `candidates` that are much like `name`, the closest first."""
    by_plain = {plain(candidate): candidate for candidate in candidates}
    close = difflib.get_close_matches(plain(name), by_plain, n=3, cutoff=0.5)
    return [by_plain[text] for text in close]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
