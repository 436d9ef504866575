"""Reading and writing recorded logs: CSV, Parquet and NPZ.

A log has the column `t` (s), inputs, outputs, and may have truth columns for scoring; which
ones is a value, [`Signals`][]. `y[k]` is sampled at `t[k]`; `u[k]` is the mean input over
`[t[k], t[k+1])`. A log that cannot be used is refused with row, column and remedy.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ._extras import require
from ._log_checks import check_columns, check_finite, check_rows, check_time
from ._log_columns import checked_mapping, select
from ._log_files import READERS, Columns, LogError as LogError
from ._log_signals import MOTOR as MOTOR, Signals as Signals

SUFFIXES = tuple(READERS)
KEPT = 1 << 27  # bytes of a log that are kept from the first reading for the second


@dataclasses.dataclass(frozen=True)
class Log:
    """A recorded run of `N` rows.

    - `t`: sampling instants (s), shape `(N,)`, strictly increasing;
    - `u`: mean inputs over `[t[k], t[k+1])`, shape `(N, m)`, the optional ones last where
      the file has them; for a motor the stator voltage (V), m = 2;
    - `y`: outputs at `t[k]`, shape `(N, n)`; for a motor the stator current (A), n = 2;
    - `truth`: the truth columns that the file has, each of shape `(N,)`.
    """

    t: Float[np.ndarray, " N"]
    u: Float[np.ndarray, "N m"]
    y: Float[np.ndarray, "N n"]
    truth: Columns


class LogReader:
    """A log that is read, checked and given piece by piece, so that it need not fit into
    memory. Arguments and refusals are those of [`read_log`][].

    - `t`: every sampling instant (s), shape `(N,)`; `interval`: the median one (s);
    - `optional`: whether the file has the optional inputs;
    - `truth`: the truth columns that it has.

    `watch(log)` is told every batch of the first reading, before time has been checked.
    """

    t: Float[np.ndarray, " N"]
    interval: float
    optional: bool
    truth: tuple[str, ...]

    def __init__(
        self,
        path: Path | str,
        signals: Signals = MOTOR,
        *,
        columns: Mapping[str, str] | None = None,
        truth: bool = True,
        max_gap: float | None = None,
        watch: Callable[[Log], object] = lambda log: None,
    ):
        path = Path(path)
        if max_gap is not None and not max_gap > 0:
            raise LogError(
                "Argument `max_gap` (option --max-gap) must be positive (s), but got "
                f"{max_gap}."
            )
        mapped = checked_mapping(columns or {}, signals)
        if not truth:
            signals = dataclasses.replace(signals, truth=())
        names = {name: mapped.get(name, name) for name in signals.names}
        if not path.exists():
            raise FileNotFoundError(f"{path} does not exist.")
        if path.is_dir():
            raise LogError(f"{path} is a directory, but a log is a file.")
        self.path, self.signals = path, signals
        read = READERS[check_suffix(path).suffix.lower()]
        self._source = read(
            path, lambda available: select(path, signals, names, mapped, available)
        )
        chosen = self._source.chosen
        self.optional = any(name in chosen for name in signals.optional)
        self.truth = tuple(name for name in signals.truth if name in chosen)
        self._kept: list[Columns] | None = []
        self.t = self._checked(watch, max_gap)

    def _checked(
        self, watch: Callable[[Log], object], max_gap: float | None
    ) -> Float[np.ndarray, " N"]:
        """Every instant, after a look at every value. A log that is not long is kept."""
        source, instants, size = self._source, [], 0
        for data in source.batches():
            rows = sum(map(len, instants))
            check_columns(self.path, data, source.chosen)
            check_finite(
                self.path,
                data,
                source.chosen,
                lambda row, first=rows: source.where(first + row),
                self.truth,
            )
            instants.append(np.array(data["t"]))
            watch(self._log(data))
            size += sum(column.nbytes for column in data.values())
            if self._kept is not None and size <= KEPT:
                self._kept.append(data)
            else:
                self._kept = None
        t = np.concatenate(instants)
        instants.clear()
        check_rows(self.path, t.size)
        label = source.chosen["t"]
        self.interval = check_time(self.path, t, label, source.where, max_gap)
        return t

    def pieces(self, rows: int) -> Iterator[Log]:
        """The log in pieces of at most `rows` intervals, each of which begins with the last
        row of the one before; their lengths differ by at most one."""
        intervals = self.t.size - 1
        edges = np.linspace(0, intervals, -(-intervals // rows) + 1).astype(int)
        batches = iter(self._source.batches() if self._kept is None else self._kept)
        held, first = next(batches), 0  # the rows from `first` on
        for begin, end in itertools.pairwise(edges):
            parts = [{k: x[begin - first :] for k, x in held.items()}]
            first, have = begin, parts[0]["t"].size
            while first + have <= end:
                parts.append(next(batches))
                have += parts[-1]["t"].size
            held = {k: np.concatenate([p[k] for p in parts]) for k in held}
            yield self._log({k: x[: end + 1 - begin] for k, x in held.items()})

    def _log(self, data: Columns) -> Log:
        optional = self.signals.optional if self.optional else ()
        return Log(
            t=data["t"],
            u=_stacked(data, [*self.signals.inputs, *optional]),
            y=_stacked(data, self.signals.outputs),
            truth={name: data[name] for name in self.truth},
        )


def read_log(
    path: Path | str,
    signals: Signals = MOTOR,
    *,
    columns: Mapping[str, str] | None = None,
    truth: bool = True,
    max_gap: float | None = None,
) -> Log:
    """Read the log `path`, a .csv, .parquet or .npz file.

    - `signals`: the columns to read, by default those of a motor;
    - `columns`: what the file calls a column, `{"u_alpha": "Ualpha"}`, where that differs;
    - `truth`: whether to read the truth columns;
    - `max_gap`: the longest interval allowed (s), by default ten times the median one.

    A CSV is UTF-8, separated by commas, semicolons (decimal commas allowed) or tabs, with
    its names in the first line; other columns are ignored.

    **Raises:** `LogError` for a sample that is blank, not a number or not finite, for time
    that repeats or runs backwards, for a gap above `max_gap`, for a column that is missing,
    ambiguous or of the wrong shape. `OSError` where the file cannot be opened.
    """
    reader = LogReader(path, signals, columns=columns, truth=truth, max_gap=max_gap)
    (log,) = reader.pieces(reader.t.size)
    return log


def _stacked(data: Columns, names: Iterable[str]) -> Float[np.ndarray, "N n"]:
    columns = [data[name] for name in names]
    return np.stack(columns, axis=1) if columns else np.zeros((data["t"].size, 0))


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
