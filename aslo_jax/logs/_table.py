"""Tables of numbers, written piece by piece."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ._error import LogError

SUFFIXES = (".csv", ".parquet", ".npz")


class TableWriter:
    """A table that is written piece by piece, in the format of the suffix of its `path`;
    every piece has the same columns. A context that is left writes the end.

    Every digit of a float64 is kept, in CSV too. An .npz file is written at the end, from
    memory."""

    def __init__(self, path: Path | str):
        self.path = check_suffix(path)
        self._suffix = self.path.suffix.lower()
        self._pieces: list[dict[str, np.ndarray]] = []
        self._file: Any = None
        if self._suffix != ".npz":
            require("pyarrow.csv" if self._suffix == ".csv" else "pyarrow.parquet", "cli")

    def write(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append `columns`, each of shape `(N,)`."""
        if self._suffix == ".npz":
            self._pieces.append(dict(columns))
            return
        table = require("pyarrow", "cli").table(dict(columns))
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
        if self._suffix == ".npz" and kind is None:
            names = self._pieces[0] if self._pieces else {}
            one = len(self._pieces) == 1
            whole = {
                k: names[k] if one else np.concatenate([p[k] for p in self._pieces])
                for k in names
            }
            with self.path.open("wb") as file:
                np.savez(file, **whole)  # pyright: ignore[reportArgumentType]


def write_table(path: Path | str, columns: Mapping[str, np.ndarray]) -> None:
    """Write `columns`, each of shape `(N,)`, in the format of the suffix of `path`.

    Every digit of a float64 is kept, in CSV too."""
    with TableWriter(path) as writer:
        writer.write(columns)


def check_suffix(path: Path | str) -> Path:
    """Refuse a table whose suffix is not that of a known format."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(
            f"{path} has the suffix {path.suffix!r}, but a table is one of "
            f"{', '.join(SUFFIXES)}."
        )
    return path
