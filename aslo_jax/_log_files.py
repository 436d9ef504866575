"""Columns from CSV, Parquet and NPZ files, and the place of a row in them.

pyarrow reads a CSV; where it refuses, a second, slow look with the standard library finds
the line and the column to name.
"""

import csv
import dataclasses
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ._extras import require

Columns = dict[str, Float[np.ndarray, " N"]]
Select = Callable[[list[str]], dict[str, str]]
Where = Callable[[int], str]


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


def read_csv(path: Path, select: Select) -> tuple[Columns, Where]:
    """The selected columns as float64, by our names, and the place of a row."""
    pyarrow, reader = require("pyarrow", "cli"), require("pyarrow.csv", "cli")
    layout = _layout(path)
    chosen = select(layout.names)
    # Columns go by their position, since names that are not read may be repeated.
    position = {name: str(layout.names.index(actual)) for name, actual in chosen.items()}
    wanted = list(position.values())
    try:
        table = reader.read_csv(
            path,
            reader.ReadOptions(
                column_names=[str(k) for k in range(len(layout.names))],
                skip_rows=layout.line,
            ),
            reader.ParseOptions(delimiter=layout.delimiter),
            reader.ConvertOptions(
                column_types=dict.fromkeys(wanted, pyarrow.float64()),
                include_columns=wanted,
                null_values=[""],
                decimal_point=layout.decimal_point,
            ),
        )
    except pyarrow.ArrowException as error:
        raise _diagnosis(layout, list(chosen.values()), str(error)) from None
    data = {
        name: _from_arrow(path, chosen[name], table.column(k), layout.where)
        for name, k in position.items()
    }
    return data, layout.where


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


def _from_arrow(path: Path, label: str, column: Any, where: Where) -> np.ndarray:
    """A column of a pyarrow table as float64; a blank is refused."""
    if column.null_count:
        row = column.is_null().to_numpy().argmax()
        raise LogError(
            f"{path}, {where(int(row))}, column `{label}`: the value is blank; remove or "
            "repair that row."
        )
    return column.cast("float64", safe=False).to_numpy()


def read_parquet(path: Path, select: Select) -> tuple[Columns, Where]:
    pyarrow, parquet = require("pyarrow", "cli"), require("pyarrow.parquet", "cli")
    types = pyarrow.types
    try:
        with parquet.ParquetFile(path) as file:
            chosen = select(file.schema_arrow.names)
            table = file.read(columns=list(chosen.values()))
    except pyarrow.ArrowException as error:
        raise LogError(f"{path} is not a readable Parquet file: {error}") from error
    for actual in chosen.values():
        kind = table.schema.field(actual).type
        if not (
            types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
        ):
            raise LogError(
                f"{path}, column `{actual}` holds {kind}, but it must hold numbers in SI "
                "units (t in seconds); convert it."
            )
    data = {k: _from_arrow(path, v, table.column(v), _row) for k, v in chosen.items()}
    return data, _row


def read_npz(path: Path, select: Select) -> tuple[Columns, Where]:
    data = {}
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("it holds a single array")
            chosen = select(file.files)
            arrays = {name: file[actual] for name, actual in chosen.items()}
    except LogError:
        raise
    except OSError:
        raise
    except Exception as error:  # zipfile, pickle and numpy each have their own
        raise LogError(
            f"{path} is not a readable NPZ file of named numeric arrays: {error}"
        ) from error
    for name, array in arrays.items():
        actual = chosen[name]
        if array.ndim != 1:
            raise LogError(
                f"{path}, column `{actual}` has shape {array.shape}, but it must be a "
                "vector, (N,); store each component under its own name."
            )
        if array.dtype.kind not in "iuf":
            raise LogError(
                f"{path}, column `{actual}` holds {array.dtype}, but it must hold real "
                "numbers; convert it."
            )
        data[name] = array.astype(float)
    return data, _row


READERS = {".csv": read_csv, ".parquet": read_parquet, ".npz": read_npz}
