"""Reading and writing recorded logs: CSV, Parquet and NPZ.

A log has the column `t` (s), inputs, outputs, and may have truth columns for scoring; which
ones is a value, [`Signals`][]. `y[k]` is sampled at `t[k]`; `u[k]` is the mean input over
`[t[k], t[k+1])`. A log that cannot be used is refused with row, column and remedy.
"""

import dataclasses
import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ._extras import require
from ._log_files import READERS, Columns, LogError as LogError, Where

SUFFIXES = tuple(READERS)
GAP_IN_MEDIANS = 10.0  # the default of `max_gap`, in median intervals


@dataclasses.dataclass(frozen=True)
class Signals:
    """The columns of a log beside `t` (s), in SI units; by default those of a motor in the
    stationary amplitude-invariant frame, voltages (V) and currents (A) in, fluxes (Wb),
    angle (rad) and speed (rad/s) for scoring.

    - `inputs`, `outputs`: those of u and of y, in order;
    - `optional`: further inputs, all or none of them;
    - `truth`: for scoring only, any of them;
    - `note`: frame and sign of these, in words.
    """

    inputs: tuple[str, ...] = ("u_alpha", "u_beta")
    outputs: tuple[str, ...] = ("i_alpha", "i_beta")
    optional: tuple[str, ...] = ()
    truth: tuple[str, ...] = (
        "flux_alpha",
        "flux_beta",
        "theta_electrical",
        "omega_electrical",
        "omega_mechanical",
    )
    note: str = "stationary frame, amplitude-invariant"

    @property
    def required(self) -> tuple[str, ...]:
        """What every log must have, `t` first."""
        return ("t", *self.inputs, *self.outputs)

    @property
    def names(self) -> tuple[str, ...]:
        """Every column that may be read."""
        return (*self.required, *self.optional, *self.truth)


MOTOR = Signals()


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
    path = Path(path)
    if max_gap is not None and not max_gap > 0:
        raise LogError(
            "Argument `max_gap` (option --max-gap) must be positive (s), but got "
            f"{max_gap}."
        )
    mapped = _checked_mapping(columns or {}, signals)
    if not truth:
        signals = dataclasses.replace(signals, truth=())
    names = {name: mapped.get(name, name) for name in signals.names}

    def select(available: list[str]) -> dict[str, str]:
        return _select(path, signals, names, mapped, available)

    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        raise LogError(f"{path} is a directory, but a log is a file.")
    data, where = READERS[check_suffix(path).suffix.lower()](path, select)
    labels = {name: names[name] for name in data}
    _check_lengths(path, data, labels)
    _check_finite(path, data, labels, where, signals.truth)
    _check_time(path, data["t"], labels["t"], where, max_gap)
    inputs = [*signals.inputs, *(name for name in signals.optional if name in data)]
    return Log(
        t=data["t"],
        u=_stacked(data, inputs),
        y=_stacked(data, signals.outputs),
        truth={name: data[name] for name in signals.truth if name in data},
    )


def _stacked(data: Columns, names: Iterable[str]) -> Float[np.ndarray, "N n"]:
    columns = [data[name] for name in names]
    return np.stack(columns, axis=1) if columns else np.zeros((data["t"].size, 0))


def write_table(path: Path | str, columns: Mapping[str, np.ndarray]) -> None:
    """Write `columns`, each of shape `(N,)`, in the format of the suffix of `path`.

    Every digit of a float64 is kept, in CSV too."""
    path = check_suffix(path)
    if path.suffix.lower() == ".npz":
        with path.open("wb") as file:
            np.savez(file, **columns)  # pyright: ignore[reportArgumentType]
        return
    table = require("pyarrow", "cli").table(dict(columns))
    if path.suffix.lower() == ".csv":
        csv = require("pyarrow.csv", "cli")
        header = (",".join(columns) + "\n").encode()
        with path.open("wb") as file:
            file.write(header)
            csv.write_csv(table, file, csv.WriteOptions(include_header=False))
    else:
        require("pyarrow.parquet", "cli").write_table(table, path)


def check_suffix(path: Path | str) -> Path:
    """Refuse a table whose suffix is not that of a known format."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(
            f"{path} has the suffix {path.suffix!r}, but a table is one of "
            f"{', '.join(SUFFIXES)}."
        )
    return path


def _checked_mapping(columns: Mapping[str, str], signals: Signals) -> dict[str, str]:
    for name in columns:
        if name not in signals.names:
            close = _closest(name, signals.names)
            hint = f"; did you mean `{close[0]}`?" if close else ""
            raise LogError(
                f"Argument `columns` (option --column) must name one of "
                f"{', '.join(signals.names)}, but got `{name}`{hint}"
            )
    return dict(columns)


def _select(
    path: Path,
    signals: Signals,
    names: Mapping[str, str],
    mapped: Mapping[str, str],
    available: list[str],
) -> dict[str, str]:
    """The columns to read, by our names: those required, and of the others those there."""
    chosen = {}
    lacking = []
    some = any(names[name] in available for name in signals.optional)
    for name, actual in names.items():
        count = available.count(actual)
        if count > 1:
            places = [str(k + 1) for k, other in enumerate(available) if other == actual]
            raise LogError(
                f"{path} has {count} columns called `{actual}` (columns "
                f"{', '.join(places)}); rename all but one."
            )
        needed = name in signals.required or name in mapped
        if count == 1:
            chosen[name] = actual
        elif needed or (some and name in signals.optional):
            lacking.append(name)
    if lacking:
        _refuse_missing(path, lacking, signals, names, mapped, available)
    sources = list(chosen.values())
    for name, actual in chosen.items():
        if sources.count(actual) > 1:
            both = " and ".join(f"`{k}`" for k, v in chosen.items() if v == actual)
            name = next(k for k in mapped if chosen.get(k) == actual)
            raise LogError(
                f"Column `{actual}` of {path} is read as {both}, where it can be only one; "
                f"map `{name}` to another column."
            )
    return chosen


def _refuse_missing(
    path: Path,
    lacking: list[str],
    signals: Signals,
    names: Mapping[str, str],
    mapped: Mapping[str, str],
    available: list[str],
) -> None:
    if available and all(_is_number(name) for name in available):
        raise LogError(
            f"The first line of {path} holds numbers, but it must name the columns; add a "
            f"header line such as {','.join(signals.required)}."
        )
    free = [name for name in available if name not in names.values()]
    hints = []
    for name in lacking:
        # What the user called it says more than what we do.
        close = [*_closest(names[name], free), *_closest(name, free)]
        if close and name in mapped:
            others = ", ".join(f"`{other}`" for other in dict.fromkeys(close))
            hints.append(f"--column {name}={close[0]} (close to it: {others})")
        elif close:
            free.remove(close[0])
            hints.append(f"--column {name}={close[0]}")
    columns = ", ".join(f"`{names[name]}`" for name in lacking)
    plural = "s" if len(lacking) > 1 else ""
    if hints:
        remedy = f"perhaps it goes by another name: {' '.join(hints)}"
    else:
        remedy = f"if it goes by another name, map it: --column {lacking[0]}=NAME"
    if all(name in signals.optional and name not in mapped for name in lacking):
        remedy += f"; or give none of {', '.join(signals.optional)}"
    has = ", ".join(f"`{name}`" for name in available) or "none"
    raise LogError(
        f"{path} has no column{plural} {columns}; {remedy} (in Python, `columns=`). "
        f"Its columns: {has}."
    )


def _closest(name: str, candidates: Iterable[str]) -> list[str]:
    """Up to three of the `candidates` that are much like `name`, the closest first."""

    def plain(text: str) -> str:
        return "".join(c for c in text.lower() if c.isalnum())

    by_plain = {plain(candidate): candidate for candidate in candidates}
    close = difflib.get_close_matches(plain(name), by_plain, n=3, cutoff=0.5)
    if not close and name == "t":
        close = [text for text in by_plain if text.startswith(("t", "sec"))][:1]
    return [by_plain[text] for text in close]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_lengths(path: Path, data: Columns, labels: Mapping[str, str]) -> None:
    rows = data["t"].size
    for name, column in data.items():
        if column.size != rows:
            raise LogError(
                f"{path}, column `{labels[name]}` has {column.size} entries, but "
                f"`{labels['t']}` has {rows}; every column must have the same length."
            )
    if rows < 2:
        raise LogError(
            f"{path} has {rows} row{'' if rows == 1 else 's'} of samples, but a log must "
            "have at least 2."
        )


def _check_finite(
    path: Path,
    data: Columns,
    labels: Mapping[str, str],
    where: Where,
    truths: tuple[str, ...],
) -> None:
    bad = {name: ~np.isfinite(column) for name, column in data.items()}
    first = {name: int(np.argmax(b)) for name, b in bad.items() if b.any()}
    if first:
        name = min(first, key=lambda name: first[name])
        row = first[name]
        aside = " (or leave truth out, --no-truth)" if name in truths else ""
        raise LogError(
            f"{path}, {where(row)}, column `{labels[name]}`: the value is "
            f"{data[name][row]}, but it must be finite; remove or repair that row{aside}."
        )


def _check_time(
    path: Path,
    t: Float[np.ndarray, " N"],
    label: str,
    where: Where,
    max_gap: float | None,
) -> None:
    gaps = np.diff(t)
    if not (gaps > 0).all():
        row = int(np.argmin(gaps > 0)) + 1
        how = "repeats" if gaps[row - 1] == 0 else "runs backwards"
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: time {how}, {t[row]:.12g} s after "
            f"{t[row - 1]:.12g} s; sort the log and drop repeated rows."
        )
    median = float(np.median(gaps))
    limit = GAP_IN_MEDIANS * median if max_gap is None else max_gap
    if (gaps > limit).any():
        row = int(np.argmax(gaps > limit)) + 1
        by_default = "ten median intervals" if max_gap is None else "max_gap"
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: a gap of {gaps[row - 1]:.6g} s "
            f"before {t[row]:.12g} s, above the limit of {limit:.6g} s ({by_default}); "
            "split the log there or raise the limit, --max-gap (in Python, `max_gap=`)."
        )
