"""Reading and writing recorded logs: CSV, Parquet and NPZ.

A log has the columns `t` (s), `u_alpha`, `u_beta` (V) and `i_alpha`, `i_beta` (A), and may
have truth columns for scoring: `flux_alpha`, `flux_beta` (Wb), `theta_electrical` (rad),
`omega_mechanical` (rad/s). `i[k]` is sampled at `t[k]`; `u[k]` is the mean voltage over
`[t[k], t[k+1])`. A log that cannot be used is refused with row, column and remedy.
"""

import dataclasses
import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ._extras import require
from ._log_files import READERS, Columns, LogError as LogError, Where

SIGNALS = ("t", "u_alpha", "u_beta", "i_alpha", "i_beta")
TRUTH = ("flux_alpha", "flux_beta", "theta_electrical", "omega_mechanical")
SUFFIXES = tuple(READERS)
GAP_IN_MEDIANS = 10.0  # the default of `max_gap`, in median intervals


@dataclasses.dataclass(frozen=True)
class Log:
    """A recorded run of `N` rows.

    - `t`: sampling instants (s), shape `(N,)`, strictly increasing;
    - `u`: mean stator voltage over `[t[k], t[k+1])` (V), shape `(N, 2)`;
    - `y`: stator current at `t[k]` (A), shape `(N, 2)`;
    - `truth`: the truth columns that the file has, each of shape `(N,)`.
    """

    t: Float[np.ndarray, " N"]
    u: Float[np.ndarray, "N 2"]
    y: Float[np.ndarray, "N 2"]
    truth: Columns


def read_log(
    path: Path | str,
    *,
    columns: Mapping[str, str] | None = None,
    truth: bool = True,
    max_gap: float | None = None,
) -> Log:
    """Read the log `path`, a .csv, .parquet or .npz file.

    - `columns`: what the file calls a column, `{"u_alpha": "Ualpha"}`, where that differs
      from the names above;
    - `truth`: whether to read the truth columns;
    - `max_gap`: the longest interval allowed (s), by default ten times the median one.

    A CSV is UTF-8, separated by commas, semicolons (decimal commas allowed) or tabs, with
    its names in the first line; other columns are ignored.

    **Raises:** `LogError` for a sample that is blank, not a number or not finite, for time
    that repeats or runs backwards, for a gap above `max_gap`, for a column that is missing,
    ambiguous or of the wrong shape. `OSError` where the file cannot be opened.
    """
    path = Path(path)
    wanted = (*SIGNALS, *TRUTH) if truth else SIGNALS
    names = {name: name for name in wanted} | _checked_mapping(columns or {})
    names = {name: names[name] for name in wanted}

    def select(available: list[str]) -> dict[str, str]:
        return _select(path, names, columns or {}, available)

    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        raise LogError(f"{path} is a directory, but a log is a file.")
    data, where = READERS[check_suffix(path).suffix.lower()](path, select)
    labels = {name: names[name] for name in data}
    _check_lengths(path, data, labels)
    _check_finite(path, data, labels, where)
    _check_time(path, data["t"], labels["t"], where, max_gap)
    return Log(
        t=data["t"],
        u=np.stack([data["u_alpha"], data["u_beta"]], axis=1),
        y=np.stack([data["i_alpha"], data["i_beta"]], axis=1),
        truth={name: data[name] for name in TRUTH if name in data},
    )


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


def _checked_mapping(columns: Mapping[str, str]) -> dict[str, str]:
    known = (*SIGNALS, *TRUTH)
    for name in columns:
        if name not in known:
            close = _closest(name, known)
            hint = f"; did you mean `{close}`?" if close else ""
            raise LogError(
                f"Argument `columns` (option --column) must name one of "
                f"{', '.join(known)}, but got `{name}`{hint}"
            )
    return dict(columns)


def _select(
    path: Path, names: Mapping[str, str], mapped: Mapping[str, str], available: list[str]
) -> dict[str, str]:
    """The columns to read, by our names: those required and the truth that is there."""
    chosen = {}
    lacking = []
    for name, actual in names.items():
        count = available.count(actual)
        if count > 1:
            places = [str(k + 1) for k, other in enumerate(available) if other == actual]
            raise LogError(
                f"{path} has {count} columns called `{actual}` (columns "
                f"{', '.join(places)}); rename all but one."
            )
        if count == 1:
            chosen[name] = actual
        elif name in SIGNALS or name in mapped:
            lacking.append(name)
    if lacking:
        _refuse_missing(path, lacking, names, available)
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
    path: Path, lacking: list[str], names: Mapping[str, str], available: list[str]
) -> None:
    if available and all(_is_number(name) for name in available):
        raise LogError(
            f"The first line of {path} holds numbers, but it must name the columns; add a "
            f"header line such as {','.join(SIGNALS)}."
        )
    free = [name for name in available if name not in names.values()]
    hints = []
    for name in lacking:
        close = _closest(name, free) or _closest(names[name], free)
        if close:
            free.remove(close)
            hints.append(f"--column {name}={close}")
    columns = ", ".join(f"`{names[name]}`" for name in lacking)
    plural = "s" if len(lacking) > 1 else ""
    if hints:
        remedy = f"perhaps it goes by another name: {' '.join(hints)}"
    else:
        remedy = f"if it goes by another name, map it: --column {lacking[0]}=NAME"
    has = ", ".join(f"`{name}`" for name in available) or "none"
    raise LogError(
        f"{path} has no column{plural} {columns}; {remedy} (in Python, `columns=`). "
        f"Its columns: {has}."
    )


def _closest(name: str, candidates: Any) -> str | None:
    def plain(text: str) -> str:
        return "".join(c for c in text.lower() if c.isalnum())

    by_plain = {plain(candidate): candidate for candidate in candidates}
    close = difflib.get_close_matches(plain(name), by_plain, n=1, cutoff=0.5)
    if not close and name == "t":
        close = [text for text in by_plain if text.startswith(("t", "sec"))][:1]
    return by_plain[close[0]] if close else None


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
    path: Path, data: Columns, labels: Mapping[str, str], where: Where
) -> None:
    bad = {name: ~np.isfinite(column) for name, column in data.items()}
    first = {name: int(np.argmax(b)) for name, b in bad.items() if b.any()}
    if first:
        name = min(first, key=lambda name: first[name])
        row = first[name]
        truth = " (or leave truth out, --no-truth)" if name in TRUTH else ""
        raise LogError(
            f"{path}, {where(row)}, column `{labels[name]}`: the value is "
            f"{data[name][row]}, but it must be finite; remove or repair that row{truth}."
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
    if not limit > 0:
        raise LogError(
            f"Argument `max_gap` (option --max-gap) must be positive (s), but got {limit}."
        )
    if (gaps > limit).any():
        row = int(np.argmax(gaps > limit)) + 1
        by_default = "ten median intervals" if max_gap is None else "max_gap"
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: a gap of {gaps[row - 1]:.6g} s "
            f"before {t[row]:.12g} s, above the limit of {limit:.6g} s ({by_default}); "
            "split the log there or raise the limit, --max-gap (in Python, `max_gap=`)."
        )
