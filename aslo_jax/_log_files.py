"""Columns from CSV, Parquet and NPZ files, batch by batch, and the place of a row in them.

pyarrow reads a CSV; where it refuses, a second, slow look with the standard library finds
the line and the column to name.
"""

import csv
import dataclasses
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from . import _npz
from ._extras import require

Columns = dict[str, Float[np.ndarray, " N"]]
Select = Callable[[list[str]], dict[str, str]]
Where = Callable[[int], str]


BATCH = 65_536  # rows of a batch of a Parquet or an NPZ file
BUFFER = 1 << 20  # bytes that are read of its columns at a time
BLOCK = 1 << 22  # bytes of a CSV file that are parsed at a time


class LogError(ValueError):
    """A log that cannot be used: names file, row, column and remedy."""


@dataclasses.dataclass(frozen=True)
class _Layout:
    """How the file is written: names, the line that holds them, separators."""

    path: Path
    names: list[str]
    line: int
    delimiter: str
    decimal_point: str

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """The line number (from 1) and the cells of every row of samples."""
        with self.path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            reader = csv.reader(file, delimiter=self.delimiter)
            try:
                for cells in reader:
                    if cells and reader.line_num > self.line:
                        yield reader.line_num, cells
            except csv.Error as error:
                raise LogError(
                    f"{self.path}, line {reader.line_num}: {error}; repair that line."
                ) from error

    def where(self, row: int) -> str:
        """Row `row` of the samples as the line of the file that holds it."""
        line, _ = next(islice(self.rows(), row, None))
        return f"line {line}"


@dataclasses.dataclass(frozen=True)
class Source:
    """The selected columns of a file.

    - `chosen`: what the file calls them, by our names;
    - `batches()`: them as float64 by our names, from the first row on, at every call;
    - `where(row)`: the place of a row in the file, in words.
    """

    chosen: dict[str, str]
    batches: Callable[[], Iterator[Columns]]
    where: Where


def read_csv(path: Path, select: Select) -> Source:
    require("pyarrow.csv", "cli")
    layout = _layout(path)
    chosen = select(layout.names)
    return Source(chosen, lambda: _batches_of_csv(layout, chosen), layout.where)


def _batches_of_csv(layout: _Layout, chosen: dict[str, str]) -> Iterator[Columns]:
    pyarrow, reader = require("pyarrow", "cli"), require("pyarrow.csv", "cli")
    if next(layout.rows(), None) is None:
        yield {name: np.zeros(0) for name in chosen}
        return
    # Columns go by their position, since names that are not read may be repeated.
    position = {name: str(layout.names.index(actual)) for name, actual in chosen.items()}
    wanted, first = list(position.values()), 0
    try:
        with reader.open_csv(
            layout.path,
            reader.ReadOptions(
                column_names=[str(k) for k in range(len(layout.names))],
                skip_rows=layout.line,
                block_size=BLOCK,
            ),
            reader.ParseOptions(delimiter=layout.delimiter),
            reader.ConvertOptions(
                column_types=dict.fromkeys(wanted, pyarrow.float64()),
                include_columns=wanted,
                null_values=[""],
                decimal_point=layout.decimal_point,
            ),
        ) as file:
            for batch in file:
                yield {
                    name: _from_arrow(layout, chosen[name], batch.column(k), first)
                    for name, k in position.items()
                }
                first += batch.num_rows
    except pyarrow.ArrowException as error:
        raise _diagnosis(layout, list(chosen.values()), str(error)) from None


def _layout(path: Path) -> _Layout:
    first, number, sample = "", 0, ""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for line in file:
                if first and line.strip():
                    sample = line
                    break
                if not first:
                    number += 1
                    first = line.strip()
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not UTF-8 text; export it as UTF-8 CSV.") from error
    if not first:
        raise LogError(f"{path} is empty; a log begins with a line that names its columns.")
    delimiter = max(",;\t", key=first.count)
    names = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
    decimal_comma = delimiter != "," and "," in sample and "." not in sample
    return _Layout(path, names, number, delimiter, "," if decimal_comma else ".")


def _diagnosis(layout: _Layout, wanted: list[str], reason: str) -> LogError:
    columns = [(name, layout.names.index(name)) for name in wanted]
    for line, cells in layout.rows():
        if len(cells) != len(layout.names):
            return LogError(
                f"{layout.path}, line {line}: {len(cells)} cells, but the header names "
                f"{len(layout.names)} columns (is the file cut off?); remove or repair "
                "that line."
            )
        for name, k in columns:
            cell = cells[k].strip()
            if not cell:
                return LogError(
                    f"{layout.path}, line {line}, column `{name}`: the value is blank; "
                    "remove or repair that row."
                )
            try:
                float(cell.replace(layout.decimal_point, "."))
            except ValueError:
                return LogError(
                    f"{layout.path}, line {line}, column `{name}`: {cell!r} is not a "
                    "number; remove or repair that row."
                )
    return LogError(f"{layout.path} is not a readable CSV file: {reason}")


def _row(index: int) -> str:
    return f"row {index} (counted from 0)"


@dataclasses.dataclass(frozen=True)
class _Rows:
    """A file whose rows have no lines."""

    path: Path

    def where(self, row: int) -> str:
        return _row(row)


def _from_arrow(
    file: _Layout | _Rows, label: str, column: Any, first: int
) -> Float[np.ndarray, " N"]:
    """A column of a batch that begins in row `first`, as float64; a blank is refused."""
    if column.null_count:
        row = first + int(column.is_null().to_numpy(zero_copy_only=False).argmax())
        raise LogError(
            f"{file.path}, {file.where(row)}, column `{label}`: the value is blank; remove "
            "or repair that row."
        )
    return column.cast("float64", safe=False).to_numpy(zero_copy_only=False)


def read_parquet(path: Path, select: Select) -> Source:
    pyarrow, parquet = require("pyarrow", "cli"), require("pyarrow.parquet", "cli")
    types = pyarrow.types
    with _readable(path), parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
    chosen = select(schema.names)
    for actual in chosen.values():
        kind = schema.field(actual).type
        if not (
            types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
        ):
            raise LogError(
                f"{path}, column `{actual}` holds {kind}, but it must hold numbers in SI "
                "units (t in seconds); convert it."
            )
    return Source(chosen, lambda: _batches_of_parquet(path, chosen), _row)


def _batches_of_parquet(path: Path, chosen: dict[str, str]) -> Iterator[Columns]:
    parquet = require("pyarrow.parquet", "cli")
    first, rows = 0, _Rows(path)
    # One iterator for each group of rows, since it holds what it has read until its end.
    with _readable(path), parquet.ParquetFile(path, buffer_size=BUFFER) as file:
        for group in range(file.num_row_groups):
            for batch in file.iter_batches(BATCH, [group], list(chosen.values())):
                yield {
                    name: _from_arrow(rows, actual, batch.column(actual), first)
                    for name, actual in chosen.items()
                }
                first += batch.num_rows
    if not first:
        yield {name: np.zeros(0) for name in chosen}


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except require("pyarrow", "cli").ArrowException as error:
        raise LogError(f"{path} is not a readable Parquet file: {error}") from error


def read_npz(path: Path, select: Select) -> Source:
    with _readable_npz(path) as archive:
        chosen = select(_npz.names(archive))
        members = {name: _npz.member(archive, actual) for name, actual in chosen.items()}
    for name, (shape, dtype) in members.items():
        actual = chosen[name]
        if len(shape) != 1:
            raise LogError(
                f"{path}, column `{actual}` has shape {shape}, but it must be a "
                "vector, (N,); store each component under its own name."
            )
        if dtype.kind not in "iuf":
            raise LogError(
                f"{path}, column `{actual}` holds {dtype}, but it must hold real "
                "numbers; convert it."
            )
    rows = {name: shape[0] for name, (shape, _) in members.items()}
    for name, count in rows.items():
        if count != rows["t"]:
            raise LogError(
                f"{path}, column `{chosen[name]}` has {count} entries, but "
                f"`{chosen['t']}` has {rows['t']}; every column must have the same length."
            )
    return Source(chosen, lambda: _batches_of_npz(path, chosen), _row)


def _batches_of_npz(path: Path, chosen: dict[str, str]) -> Iterator[Columns]:
    with _readable_npz(path) as archive:
        yield from _npz.batches(archive, chosen, BATCH)


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


READERS = {".csv": read_csv, ".parquet": read_parquet, ".npz": read_npz}
