"""New values in the text of a TOML file, with all else, comments too, as it was."""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from .._extras import missing
from ._read import MARK

try:
    import tomlkit
    from tomlkit.items import Array, Item, Key, SingleKey, Table
except ModuleNotFoundError as error:
    raise missing("tomlkit", "cli") from error


def rounded(x: Any) -> Any:
    """A number, or numbers in lists, with seven digits: more than any record determines."""
    if isinstance(x, Sequence):
        return [rounded(each) for each in x]
    return float(f"{x:.7g}")


def rewritten(text: str, values: Mapping[str, Mapping[str, Any]]) -> str:
    """A file with new `values`, by table (`"machine"`, `"observers.ASLO"`, and `"sensor.0"`
    for the first of an array of tables) and key: numbers, or lists of them. A key that its
    table does not have yet becomes the first in it, and may be a table itself.

    **Raises:** `ValueError` where a list stands on several lines, whose comments would be
    lost, and for a table that the file does not have."""
    text, mark = text.removeprefix(MARK), MARK if text.startswith(MARK) else ""
    document, content = tomlkit.parse(text), tomllib.loads(text)
    added: list[tuple[Any, list[tuple[Key, Item]]]] = []
    for name, items in values.items():
        table, new = _existing(document, name), []
        for key, value in items.items():
            if key in table:
                _replace(table, name, key, value)
            else:
                new.append((SingleKey(key), _item(value)))
        added.append((table, new))
        table_of(content, name).update(items)
    # Last, since what is put there directly is not found by its key.
    for table, new in added:
        for key, item in reversed(new):
            if isinstance(table, Table):
                item.trivia.trail = "\n"
                table.value.body.insert(0, (key, item))
            else:
                table[key] = item
    result = tomlkit.dumps(document)
    result = result if result.endswith("\n") else f"{result}\n"
    if tomllib.loads(result) != content:
        raise ValueError(
            f"The values of {', '.join(values)} cannot be put into this file; give each of "
            "these tables a header, `[name]`, and each key a line below it."
        )
    return mark + result


def _item(value: Any) -> Item:
    """A value of one line: a mapping is a table in braces."""
    if not isinstance(value, Mapping):
        return tomlkit.item(value)
    found = tomlkit.inline_table()
    found.update(value)
    return found


def _replace(table: Any, name: str, key: str, value: Any) -> None:
    old, new = table[key], _item(value)
    if isinstance(old, Array) and "\n" in old.as_string():
        raise ValueError(
            "Values must stand on one line each, `key = value`, to be replaced, but "
            f"{name}.{key} does not."
        )
    free = len(old.as_string()) - len(new.as_string())
    table[key] = new
    trivia = table[key].trivia
    if trivia.comment:
        # Comments stay in their columns where there is room.
        trivia.comment_ws = " " * max(free + len(trivia.comment_ws), 2)


def _existing(document: Any, name: str) -> Any:
    found = document
    for part in name.split("."):
        try:
            found = found[int(part) if isinstance(found, list) else part]
        except (LookupError, ValueError):
            raise ValueError(
                f"The file must have a table `{name}` for its new values, but has none."
            ) from None
    return found


def table_of(content: dict[str, Any], name: str) -> dict[str, Any]:
    """The table of a file by its name, as in [`rewritten`][]."""
    found: Any = content
    for part in name.split("."):
        found = found[int(part)] if isinstance(found, list) else found.setdefault(part, {})
    return found
