"""Tables of numbers, written piece by piece."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ._error import LogError
from ._npz import NPZWriter

SUFFIXES = (".csv", ".parquet", ".npz")


class TableWriter:
    """A table that is written piece by piece, in the format of the suffix of its `path`;
    every piece has the same columns. A context that is left writes the end.

    Every digit of a float64 is kept, in CSV too. An .npz file is written at the end, from
    temporary files beside it."""

    def __init__(self, path: Path | str):
        self.path = check_suffix(path)
        self._suffix = self.path.suffix.lower()
        self._npz = NPZWriter(self.path) if self._suffix == ".npz" else None
        self._file: Any = None
        if self._npz is None:
            require("pyarrow.csv" if self._suffix == ".csv" else "pyarrow.parquet", "cli")

    def write(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append `columns`, each of shape `(N,)`."""
        if self._npz is not None:
            self._npz.write(columns)
            return
        table = require("pyarrow", "cli").table({n: _arrow(x) for n, x in columns.items()})
        if self._suffix == ".csv":
            csv = require("pyarrow.csv", "cli")
            if self._file is None:
                self._file = self.path.open("wb")
                self._file.write((",".join(columns) + "\n").encode())
            csv.write_csv(table, self._file, csv.WriteOptions(include_header=False))
            return
        if self._file is None:
            writer = require("pyarrow.parquet", "cli").ParquetWriter
            # Samples hardly ever repeat: a dictionary of them costs time and saves nothing.
            self._file = writer(self.path, table.schema, use_dictionary=False)
        self._file.write_table(table)

    def __enter__(self) -> "TableWriter":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if self._file is not None:
            self._file.close()
        if self._npz is not None:
            self._npz.close(complete=kind is None)


def _arrow(column: np.ndarray) -> Any:
    """A column as Arrow has it: numbers where they lie, for `pyarrow.array` imports pandas
    where that is installed, half a second."""
    pyarrow = require("pyarrow", "cli")
    if column.dtype.kind not in "iuf":
        return pyarrow.array(column)
    column = np.ascontiguousarray(column)
    kind = pyarrow.from_numpy_dtype(column.dtype)
    buffers = [None, pyarrow.py_buffer(column)]
    return pyarrow.Array.from_buffers(kind, column.size, buffers)


def write_table(path: Path | str, columns: Mapping[str, np.ndarray]) -> None:
    """Write `columns`, each of shape `(N,)`, in the format of the suffix of `path`.

    Every digit of a float64 is kept, in CSV too."""
    with TableWriter(path) as writer:
        writer.write(columns)


def check_suffix(path: Path | str) -> Path:
    """The `path` of a table, refused where its suffix is not that of a known format.

    **Raises:** [`LogError`][].
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(
            f"{path} has the suffix {path.suffix!r}, but a table is one of "
            f"{', '.join(SUFFIXES)}."
        )
    return path
