"""Files of every format as columns of numbers, batch by batch, and the place of a row in
them."""

import dataclasses
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from .._extras import require
from . import _npz
from ._error import Columns, LogError, Where

BATCH = 65_536  # rows of a batch of a Parquet or an NPZ file
BUFFER = 1 << 20  # bytes that are read of its columns at a time
WIDEST = 64  # columns of an array that are offered one by one
# What a file may have for a sample that is missing.
NOTHING = ("", "NA", "N/A", "#N/A", "n/a", "null", "NULL", "None", "NaN", "nan", "NAN", "-")


@dataclasses.dataclass(frozen=True)
class Source:
    """The columns of a file.

    - `path`: of it, or what it is, for messages;
    - `names`: what the file calls its columns, in order;
    - `batches(wanted, blanks)`: those called `wanted` as float64, from the first row on, at
      every call; a blank is NaN with `blanks`, and else refused;
    - `where(row)`: the place of a row, in words;
    - `units`: what it says of them, by name;
    - `unusable`: what it has beside them, and why that is no column;
    - `clocks`: the column of its instants, of a column that has instants of its own;
    - `resampled`: what to do where columns with different ones are needed.
    """

    path: Path | str
    names: list[str]
    batches: Callable[[Sequence[str], bool], Iterator[Columns]]
    where: Where
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    unusable: Mapping[str, str] = dataclasses.field(default_factory=dict)
    clocks: Mapping[str, str] = dataclasses.field(default_factory=dict)
    resampled: str = "resample every signal to the same instants"


def row_of(index: int) -> str:
    """The place of a row in a file without lines."""
    return f"row {index} (counted from 0)"


def from_arrow(
    path: Path, where: Where, label: str, column: Any, first: int, blanks: bool
) -> Float[np.ndarray, " N"]:
    """A column of a batch that begins in row `first`, as float64."""
    there = _valid(column)
    if there is not None and not blanks:
        row = first + int(np.argmin(there))
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: the value is blank; remove or repair "
            "that row, or --missing coast or interpolate."
        )
    # Not by `to_numpy`, which imports pandas where that is installed, half a second.
    numbers = column.cast("float64", safe=False)
    begin, size = numbers.offset, len(numbers)
    values = np.frombuffer(numbers.buffers()[1] or b"", float)[begin : begin + size]
    return values if there is None else np.where(there, values, np.nan)


def _valid(column: Any) -> Bool[np.ndarray, " N"] | None:
    """Which values of a column are not blank; `None` where none is."""
    if not column.null_count:
        return None
    flags = column.is_valid()
    bits = np.unpackbits(np.frombuffer(flags.buffers()[1], np.uint8), bitorder="little")
    return bits[flags.offset : flags.offset + len(flags)].astype(bool)


def read_parquet(path: Path) -> Source:
    require("pyarrow", "cli")
    parquet = require("pyarrow.parquet", "cli")
    with _readable(path), parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
    return Source(
        path,
        schema.names,
        lambda wanted, blanks: _batches_of_parquet(path, schema, wanted, blanks),
        row_of,
    )


def _batches_of_parquet(
    path: Path, schema: Any, wanted: Sequence[str], blanks: bool
) -> Iterator[Columns]:
    parquet, types = require("pyarrow.parquet", "cli"), require("pyarrow.types", "cli")
    for name in wanted:
        kind = schema.field(name).type
        if not (
            types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
        ):
            raise LogError(
                f"{path}, column `{name}` holds {kind}, but it must hold numbers in SI "
                "units (t in seconds); convert it."
            )
    first = 0
    # One iterator for each group of rows, since it holds what it has read until its end.
    with _readable(path), parquet.ParquetFile(path, buffer_size=BUFFER) as file:
        for group in range(file.num_row_groups):
            for batch in file.iter_batches(BATCH, [group], list(wanted)):
                yield {
                    name: from_arrow(path, row_of, name, batch.column(name), first, blanks)
                    for name in wanted
                }
                first += batch.num_rows
    if not first:
        yield {name: np.zeros(0) for name in wanted}


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except require("pyarrow", "cli").ArrowException as error:
        raise LogError(f"{path} is not a readable Parquet file: {error}") from error


def read_npz(path: Path) -> Source:
    """A file of vectors, read piece by piece; of matrices, at once."""
    unusable: dict[str, str] = {}
    members: dict[str, _npz.Member] = {}
    with _readable_npz(path) as archive:
        for name in _npz.names(archive):
            try:
                members[name] = _npz.member(archive, name)
            except ValueError as error:  # objects, which only unpickling reads
                unusable[name] = f"is not numeric: {error}"
        matrices = of_arrays(
            path,
            {n: _npz.whole(archive, n) for n, m in members.items() if len(m.shape) != 1},
        )
    vectors = {name: m for name, m in members.items() if len(m.shape) == 1}
    for name, (_, dtype) in list(vectors.items()):
        if dtype.kind not in "iuf":
            unusable[name] = _no_numbers(dtype)
            del vectors[name]
    return Source(
        path,
        [*vectors, *matrices.names],
        lambda wanted, blanks: _batches_of_npz(path, vectors, matrices, wanted),
        row_of,
        unusable=unusable | dict(matrices.unusable),
    )


def _batches_of_npz(
    path: Path,
    vectors: Mapping[str, _npz.Member],
    matrices: Source,
    wanted: Sequence[str],
) -> Iterator[Columns]:
    streamed = {name: name for name in wanted if name in vectors}
    whole = [name for name in wanted if name not in vectors]
    (held,) = matrices.batches(whole, True)
    if not streamed:
        yield held
        return
    counts = {name: vectors[name].shape[0] for name in streamed}
    counts |= {name: column.size for name, column in held.items()}
    first = next(iter(streamed))
    for name, count in counts.items():
        if count != counts[first]:
            raise LogError(
                f"{path}, column `{name}` has {count} entries, but `{first}` has "
                f"{counts[first]}; every column must have the same length."
            )
    row = 0
    with _readable_npz(path) as archive:
        for batch in _npz.batches(archive, streamed, BATCH):
            count = batch[first].size
            yield batch | {name: x[row : row + count] for name, x in held.items()}
            row += count


@contextmanager
def _readable_npz(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with _npz.opened(path) as archive:
            yield archive
    except LogError:
        raise
    except ValueError as error:
        raise LogError(
            f"{path} is not a readable NPZ file of named numeric arrays: {error}"
        ) from error


def _no_numbers(dtype: np.dtype) -> str:
    return f"holds {dtype}, but it must hold real numbers; convert it"


def of_arrays(
    path: Path | str,
    arrays: Mapping[str, np.ndarray],
    *,
    unusable: Mapping[str, str] | None = None,
    **about: Any,
) -> Source:
    """Arrays in memory: vectors are columns, and so are those of a matrix, `u[0]`,
    `u[1]`."""
    data: dict[str, np.ndarray] = {}
    refused = dict(unusable or {})
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            refused[name] = _no_numbers(array.dtype)
        elif array.ndim == 1:
            data[name] = array
        elif array.ndim == 2 and array.shape[1] == 1:
            data[name] = array[:, 0]
        else:
            refused[name] = (
                f"has shape {array.shape}, but it must be a vector, (N,), or have a column "
                f"for each signal, which is then called {name}[0]; store each component "
                "under its own name"
            )
            if array.ndim == 2 and 1 < array.shape[1] <= WIDEST:
                data |= {f"{name}[{k}]": array[:, k] for k in range(array.shape[1])}

    def batches(wanted: Sequence[str], blanks: bool) -> Iterator[Columns]:
        del blanks  # which these have as NaN
        yield {name: data[name].astype(float) for name in wanted}

    return Source(path, list(data), batches, row_of, unusable=refused, **about)
