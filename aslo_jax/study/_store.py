"""The store of a study: one Zarr group that xarray reads, written chunk by chunk.

The arrays are made as a whole, with chunks of their own for every chunk of samples. A chunk
is written in two steps: its data, then a mark in the array `internal/done`, the checksum
of the data and appears by one rename. So a process that is killed leaves chunks that are
marked and right, and chunks that are not marked and are computed again. All other files
have checksums, too ([`verification`][]).
"""

import json
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._extras import require
from .._interrupts import committing, discard
from ._lock import partial
from ._verification import (
    DONE,
    FILES,
    MARK,
    OWN,
    Damage,
    checksum,
    damage,
    damaged_files,
    file_checksums,
    mark,
    opened,
    own_checksum,
)

FORMAT = "aslo_jax_study"  # the attribute that marks a store, and its version
VERSION = 3
ORDER = "order"  # the attribute with the arrays of samples, as the checksum takes them
INTERNAL = (ORDER, FILES, OWN)  # of no interest to who reads the results


class Variable(NamedTuple):
    """A variable of a study: its dimensions, the first `sample`, and the shape and type of
    what one sample has; attributes such as `units` and `long_name`."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype
    attributes: dict[str, str]


class Schema(NamedTuple):
    """What a study writes.

    - `samples`, and how many of them in a `chunk`;
    - `variables` by name, `coordinates` by name, which is that of their dimension, and
      their `attributes`;
    - `attributes` of the whole, which decide what the numbers are: a store goes on only
      with the same ones.
    """

    samples: int
    chunk: int
    variables: dict[str, Variable]
    coordinates: dict[str, np.ndarray]
    coordinate_attributes: dict[str, dict[str, str]]
    attributes: dict[str, Any]

    @property
    def order(self) -> list[str]:
        """The arrays that hold samples, in the order of their checksum."""
        return ["sample", *self.variables]

    @property
    def chunks(self) -> int:
        return -(-self.samples // self.chunk)

    def range(self, number: int) -> tuple[int, int]:
        """The samples of a chunk, from the first to before the last."""
        first = number * self.chunk
        return first, min(first + self.chunk, self.samples)


Data = Mapping[str, np.ndarray]


class Store:
    """The Zarr group of a study at `path`, to be written chunk by chunk."""

    def __init__(self, path: Path, schema: Schema) -> None:
        self.path, self.schema = path, schema
        self._group = opened(path, "r+")

    def write(self, number: int, data: Data) -> None:
        """Write a chunk: its data, then its mark. Writing the same again is harmless."""
        first, last = self.schema.range(number)
        full = dict(data) | {"sample": np.arange(first, last)}
        for name in self.schema.order:
            self._group[name][first:last] = full[name]
        self._group[DONE][number] = MARK + checksum(
            full[name] for name in self.schema.order
        )

    def done(self) -> np.ndarray:
        """Which chunks are marked as done."""
        marks = (mark(self._group[DONE], k) for k in range(self.schema.chunks))
        return np.array([found not in (0, None) for found in marks])

    def forget(self, number: int) -> None:
        """Make a chunk one that is not done, its files removed, which may be unreadable."""
        for name in (DONE, *self.schema.order):
            discard(self.path / name / "c" / str(number))


def open_store(path: Path, schema: Schema, resume: bool, repair: bool = False) -> Store:
    """Make the store, or with `resume` go on with the one that is there, if any; what is
    damaged in it is refused, or with `repair` made again, chunks as not done.

    **Raises:** `ValueError` for a path that holds anything else: no study, a damaged one,
    or one of another configuration; none of them is touched.
    """
    if not resume:
        refuse_taken(path)
    elif _taken(path):
        _check(path, schema)
        for rest in path.rglob("*.partial"):  # of a write that was interrupted
            rest.unlink()
        if repair:
            _restore_files(path, schema)
        found = verify(path)
        if found and not repair:
            raise _damaged(path, str(found))
        _check_arrays(path, schema)
        store = Store(path, schema)
        for number in found.chunks:
            store.forget(number)
        return store
    _create(path, schema)
    return Store(path, schema)


def verify(path: Path) -> Damage:
    """What is damaged in the study at `path`, every file of which is read.

    **Raises:** `ValueError` where there is no study, or its description is damaged, which
    cannot be repaired.
    """
    attributes = current_attributes(path)
    return damage(path, attributes, order_of(attributes))


def refuse_damaged_files(path: Path, attributes: Mapping[str, Any]) -> None:
    """Refuse coordinates and descriptions of arrays that are not what was written."""
    if names := damaged_files(path, attributes):
        raise _damaged(path, str(Damage(names, (), ())))


def _restore_files(path: Path, schema: Schema) -> None:
    """Of all that is no chunk of samples, what is damaged is written again."""
    names = damaged_files(path, stored_attributes(path))
    if not names:
        return
    fresh = partial(path)
    _make(fresh, schema)
    for name in names:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (fresh / name).replace(path / name)
    shutil.rmtree(fresh)


def refuse_taken(path: Path) -> None:
    """Refuse a path that holds anything."""
    if _taken(path):
        raise ValueError(
            f"Argument `store` must be a path where there is nothing yet, but {path} "
            "exists; go on with it by `resume=True` (--resume), or choose another."
        )


def _taken(path: Path) -> bool:
    return path.exists() and (not path.is_dir() or any(path.iterdir()))


def stored_attributes(path: Path) -> dict[str, Any]:
    """The attributes of the study at `path`.

    **Raises:** `ValueError` where there is none, or its description is damaged.
    """
    meta = path / "zarr.json"
    if not meta.is_file():
        raise ValueError(
            f"{path} is not a study of aslo_jax: it has no zarr.json. It is left as it is; "
            "choose another path."
        )
    try:
        content = json.loads(meta.read_text())
        attributes = content["attributes"]
    except (ValueError, KeyError, TypeError) as error:
        raise _broken(path, "its zarr.json cannot be read") from error
    if FORMAT not in attributes:
        raise ValueError(
            f"{path} is a Zarr group, but not a study of aslo_jax: it has no attribute "
            f"`{FORMAT}`. It is left as it is; choose another path."
        )
    if attributes[FORMAT] == VERSION and attributes.get(OWN) != own_checksum(content):
        raise _broken(path, "its zarr.json is not what was written")
    return attributes


def current_attributes(path: Path) -> dict[str, Any]:
    """As [`stored_attributes`][], those of another version refused."""
    attributes = stored_attributes(path)
    if attributes[FORMAT] != VERSION:
        raise _other_version(path, attributes)
    return attributes


def order_of(attributes: Mapping[str, Any]) -> list[str]:
    """The arrays that hold samples, in the order of their checksum."""
    return json.loads(attributes[ORDER])


def _check(path: Path, schema: Schema) -> None:
    if not path.is_dir():
        raise ValueError(
            f"{path} is a file, not a study of aslo_jax. It is left as it is; choose "
            "another path."
        )
    attributes = current_attributes(path)
    for name, now in _plain(schema.attributes).items():
        was = attributes.get(name)
        if was != now:
            raise ValueError(
                f"{path} holds a study with another `{name}`, and is left as it is: "
                f"{_difference(was, now)}. Go on with the settings that it was begun with, "
                "or choose another path."
            )


def _check_arrays(path: Path, schema: Schema) -> None:
    """Every array is there, with its shape, type and chunks."""
    try:
        group = opened(path, "r")
        for name, shape, chunks, dtype in _arrays(schema):
            array = group[name]
            if (array.shape, array.chunks, array.dtype) != (shape, chunks, dtype):
                raise _damaged(path, f"its array `{name}` has another shape or type")
    except (KeyError, OSError, TypeError) as error:
        raise _damaged(path, f"an array is missing or cannot be read ({error})") from error


def _arrays(
    schema: Schema,
) -> Iterator[tuple[str, tuple[int, ...], tuple[int, ...], np.dtype]]:
    n, chunk = schema.samples, min(schema.chunk, schema.samples)
    yield "sample", (n,), (chunk,), np.dtype(np.int64)
    for name, v in schema.variables.items():
        yield name, (n, *v.shape), (chunk, *(max(k, 1) for k in v.shape)), v.dtype
    yield DONE, (schema.chunks,), (1,), np.dtype(np.int64)


def _create(path: Path, schema: Schema) -> None:
    """Beside its place first, so that it appears there complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = partial(path)
    _make(part, schema)
    with committing():
        if path.exists():
            path.rmdir()  # empty
        part.rename(path)


def _make(part: Path, schema: Schema) -> None:
    """A store without samples."""
    zarr = require("zarr", "study")
    if part.exists():  # of a process that was killed here
        shutil.rmtree(part)
    group = zarr.open_group(str(part), mode="w", zarr_format=3)
    group.attrs.update(_plain(schema.attributes) | {FORMAT: VERSION})
    # With a checksum of its own, so that whatever reads it refuses a damaged chunk.
    compressor = zarr.codecs.ZstdCodec(checksum=True)
    dims = {"sample": ("sample",), DONE: ("chunk",)}
    dims |= {name: v.dims for name, v in schema.variables.items()}
    attributes = {name: v.attributes for name, v in schema.variables.items()}
    attributes[DONE] = {"long_name": "checksum of each chunk of samples that is done"}
    attributes |= schema.coordinate_attributes
    for name, shape, chunks, dtype in _arrays(schema):
        group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=dtype,
            compressors=compressor,
            fill_value=np.nan if dtype.kind == "f" else dtype.type(0),
            dimension_names=dims[name],
            attributes=attributes.get(name, {}),
        )
    for name, values in schema.coordinates.items():
        text = values.dtype.kind == "U"  # of any length: those of fixed length are Python's
        array = group.create_array(
            name,
            shape=values.shape,
            chunks=values.shape,
            dtype=str if text else values.dtype,
            compressors=compressor,
            dimension_names=(name,),
            attributes=attributes.get(name, {}),
        )
        array[:] = values.astype(object) if text else values
    group.attrs.update(
        {ORDER: json.dumps(schema.order), FILES: json.dumps(file_checksums(part))}
    )
    with warnings.catch_warnings():
        # That other libraries than Zarr's may not know it.
        warnings.filterwarnings("ignore", "Consolidated metadata")
        zarr.consolidate_metadata(str(part))
    content = json.loads((part / "zarr.json").read_text())
    content["attributes"][OWN] = own_checksum(content)
    (part / "zarr.json").write_text(json.dumps(content, indent=2))


def _damaged(path: Path, what: str) -> ValueError:
    return ValueError(
        f"{path} is a damaged study: {what}. It is left as it is; `repair=True` "
        "(--resume --repair) computes again what is damaged."
    )


def _broken(path: Path, what: str) -> ValueError:
    return ValueError(
        f"{path} is a damaged study: {what}. It is left as it is; choose another path, or "
        "remove it to start again."
    )


def _other_version(path: Path, attributes: Mapping[str, Any]) -> ValueError:
    return ValueError(
        f"{path} has version {attributes[FORMAT]} of the format of studies, but this "
        f"aslo_jax writes version {VERSION}. It is left as it is; choose another path."
    )


def _plain(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """As they come back from JSON."""
    return json.loads(json.dumps(dict(attributes)))


def _difference(was: Any, now: Any) -> str:
    """The first thing that differs, in JSON texts and in plain values."""
    try:
        old, new = json.loads(was), json.loads(now)
    except (TypeError, ValueError):
        old, new = was, now
    path = ""
    while isinstance(old, dict) and isinstance(new, dict):
        key = next(k for k in (*old, *new) if old.get(k) != new.get(k))
        path, old, new = f"{path}.{key}" if path else key, old.get(key), new.get(key)
    at = f"`{path}` was " if path else "it was "
    return f"{at}{_short(old)}, now it is {_short(new)}"


def _short(x: Any) -> str:
    text = str(x)
    return text if len(text) < 200 else f"{text[:200]}..."
