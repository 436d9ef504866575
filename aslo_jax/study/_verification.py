"""What is damaged in the store of a study, and its mending.

Every chunk of samples has a checksum, its mark in the array `internal/done`. All other
files, the descriptions of arrays and the coordinates, are written once, and their checksums
are in the attributes of the store, which have one themselves, together with the copy of all
descriptions beside them (consolidated metadata) that xarray opens a store by.
"""

import json
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._extras import require

FILES = "files"  # the attribute that holds checksums of files, as JSON
OWN = "checksum"  # the attribute that holds that of all attributes but itself
DONE = "internal/done"  # in a group of its own, so that xarray does not show it
MARK = 2**32  # added to a checksum of 32 bits, so that a mark is never zero


class Damage(NamedTuple):
    """What is damaged in a store.

    - `files` that are missing or not what was written, besides chunks of samples;
    - `chunks` of samples that are marked as done and are not what was written, by number,
      or whose mark cannot be read;
    - `missing`: chunks of samples that are not done yet, by number.
    """

    files: tuple[str, ...]
    chunks: tuple[int, ...]
    missing: tuple[int, ...]

    def __bool__(self) -> bool:
        return bool(self.files or self.chunks)

    def __str__(self) -> str:
        said = []
        if self.files:
            said.append(_not_right("file", ", ".join(self.files), len(self.files)))
        if self.chunks:
            said.append(_not_right("chunk", ranges(self.chunks), len(self.chunks)))
        return "; ".join(said) or "nothing is damaged"


def _not_right(what: str, which: str, count: int) -> str:
    several = f"{what}s {which} are" if count > 1 else f"{what} {which} is"
    return f"{several} not what was written"


def ranges(numbers: Iterable[int]) -> str:
    """Numbers in ascending order, those in a row as `3-7`."""
    found: list[list[int]] = []
    for k in numbers:
        if found and k == found[-1][1] + 1:
            found[-1][1] = k
        else:
            found.append([k, k])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in found)


def opened(path: Path, mode: str) -> Any:
    """The Zarr group of a store, by the descriptions of its arrays, not by their copy."""
    zarr = require("zarr", "study")
    return zarr.open_group(str(path), mode=mode, zarr_format=3, use_consolidated=False)


def file_checksums(path: Path) -> dict[str, int]:
    """Of every file of a store that was just made, but its own description."""
    files = (p for p in path.rglob("*") if p.is_file() and p != path / "zarr.json")
    return {p.relative_to(path).as_posix(): zlib.crc32(p.read_bytes()) for p in files}


def damaged_files(path: Path, attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """Those of a store whose checksum is not that in its attributes."""

    def right(name: str, checksum: int) -> bool:
        try:
            return zlib.crc32((path / name).read_bytes()) == checksum
        except OSError:
            return False

    files = json.loads(attributes.get(FILES, "{}"))
    return tuple(
        sorted(name for name, checksum in files.items() if not right(name, checksum))
    )


def own_checksum(content: Mapping[str, Any]) -> str:
    """Of the description of a store, the content of its `zarr.json`; a text, since not
    every format that xarray writes has such large numbers."""
    rest = {name: x for name, x in content["attributes"].items() if name != OWN}
    whole = json.dumps({**content, "attributes": rest}, sort_keys=True)
    return f"{zlib.crc32(whole.encode()):08x}"


def checksum(arrays: Any) -> int:
    """Of the numbers of arrays."""
    found = 0
    for array in arrays:
        found = zlib.crc32(np.ascontiguousarray(array).tobytes(), found)
    return found


def mark(array: Any, number: int) -> int | None:
    """That of a chunk, zero where it is not done, `None` where it cannot be read."""
    try:
        found = int(np.asarray(array[number]))
    except Exception:  # whatever a codec raises
        return None
    return found if found == 0 or 0 <= found - MARK < 2**32 else None


def damage(path: Path, attributes: Mapping[str, Any], names: Iterable[str]) -> Damage:
    """That of the store at `path` with these attributes, whose chunks of samples are made
    of the arrays `names`, in the order of their checksums."""
    files = damaged_files(path, attributes)
    chunk, samples = int(attributes["chunk"]), int(attributes["samples"])
    count = -(-samples // chunk)
    # An array whose description is damaged cannot be read, whatever its chunks are.
    if any(name.endswith("zarr.json") for name in files):
        return Damage(files, (), ())
    group = opened(path, "r")
    names, chunks, missing = list(names), [], []
    for number in range(count):
        wanted = mark(group[DONE], number)
        if wanted == 0:
            missing.append(number)
        elif wanted is None or not _is_right(group, names, number, chunk, samples, wanted):
            chunks.append(number)
    return Damage(files, tuple(chunks), tuple(missing))


def _is_right(
    group: Any, names: list[str], number: int, chunk: int, samples: int, wanted: int
) -> bool:
    rows = slice(number * chunk, min((number + 1) * chunk, samples))
    try:
        return MARK + checksum(np.asarray(group[name][rows]) for name in names) == wanted
    except Exception:  # whatever a codec raises
        return False
