"""New values in the text of a TOML file, with all else, comments too, as it was."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any

HEADER = re.compile(r"\s*(\[\[?)(.+?)\]\]?\s*(?:#.*)?$")
ENTRY = re.compile(r"(\s*([\w-]+)\s*=\s*)(\[[^\]#]*\]|[^#\s\[]+)(\s*(?:#.*)?)$")


def rewritten(text: str, values: Mapping[str, Mapping[str, Any]]) -> str:
    """A file with new `values`, by table (`"machine"`, `"observers.ASLO"`, and `"sensor.0"`
    for the first of an array of tables) and key: numbers, or lists of them.

    **Raises:** `ValueError` where a value is not on one line of its own."""
    lines = text.splitlines()
    table, counts, done, heads = "", dict[str, int](), set[tuple[str, str]](), {}
    for k, line in enumerate(lines):
        header = HEADER.match(line)
        if header and (name := _name(header[2])):
            table = name
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = f"{table}.{counts[table]}"
            heads[table] = k
            continue
        found = ENTRY.match(line)
        if found and found[2] in values.get(table, {}):
            new = repr(values[table][found[2]])
            # Comments stay in their columns where there is room.
            tail = found[4]
            if tail.strip():
                free = len(found[3]) + len(tail) - len(tail.lstrip()) - len(new)
                tail = " " * max(free, 2) + tail.lstrip()
            lines[k] = found[1] + new + tail
            done.add((table, found[2]))
    content = tomllib.loads(text.lstrip("\ufeff"))
    missing = [
        (table, key)
        for table, items in values.items()
        for key in items
        if (table, key) not in done
    ]
    # From the last table to the first, so that what is inserted moves no other header.
    for table, key in sorted(missing, key=lambda pair: heads.get(pair[0], 0), reverse=True):
        if table in heads and key not in table_of(content, table):
            lines.insert(heads[table] + 1, f"{key} = {values[table][key]!r}")
    result = "\n".join(lines) + "\n"
    for table, items in values.items():
        table_of(content, table).update(items)
    if tomllib.loads(result.lstrip("\ufeff")) != content:
        names = ", ".join(f"{table}.{key}" for table, key in missing)
        raise ValueError(
            "Values must stand on one line each, `key = value`, below the header of their "
            f"table to be replaced, but {names} does not."
        )
    return result


def _name(header: str) -> str | None:
    """The name between the brackets of a header, without quotes; `None` if it is none."""
    try:
        inner = tomllib.loads(f"[{header}]")
    except tomllib.TOMLDecodeError:
        return None
    parts = []
    while inner:
        ((part, inner),) = inner.items()
        parts.append(part)
    return ".".join(parts)


def table_of(content: dict[str, Any], name: str) -> dict[str, Any]:
    """The table of a file by its name, as in [`rewritten`][]."""
    found: Any = content
    for part in name.split("."):
        found = found[int(part)] if isinstance(found, list) else found.setdefault(part, {})
    return found
