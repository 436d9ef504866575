"""What a log must be: of one length, finite, its time increasing without gaps."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ._error import Columns, LogError, Where

GAP_IN_MEDIANS = 10.0  # the default of `max_gap`, in median intervals


def check_columns(path: Path | str, data: Columns, labels: Mapping[str, str]) -> None:
    """Refuse columns of different lengths."""
    rows = data["t"].size
    for name, column in data.items():
        if column.size != rows:
            raise LogError(
                f"{path}, column `{labels[name]}` has {column.size} entries, but "
                f"`{labels['t']}` has {rows}; every column must have the same length."
            )


def check_rows(path: Path | str, rows: int) -> None:
    """Refuse a log that has no interval."""
    if rows < 2:
        raise LogError(
            f"{path} has {rows} row{'' if rows == 1 else 's'} of samples, but a log must "
            "have at least 2."
        )


def check_finite(
    path: Path | str,
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
            f"{data[name][row]}, but it must be finite; remove or repair that row"
            f"{aside}."
        )


def check_time(
    path: Path | str,
    t: Float[np.ndarray, " N"],
    label: str,
    where: Where,
    max_gap: float | None,
) -> float:
    """The median interval (s), after a look at all of them."""
    gaps = np.diff(t)
    if not (gaps > 0).all():
        row = int(np.argmin(gaps > 0)) + 1
        how = "repeats" if gaps[row - 1] == 0 else "runs backwards"
        if (gaps >= 0).all() and (why := _coarse(t, gaps)):
            raise LogError(
                f"{path}, {where(row)}, column `{label}`: time repeats, {t[row]:.12g} s, "
                f"in {int((gaps == 0).sum())} of {gaps.size} intervals: its instants are "
                f"{why}, too coarse for this log; write more digits, from a clock in "
                "double precision, or, if rows are even, "
                f"t as {(t[-1] - t[0]) / gaps.size:.6g} s times the number of the row."
            )
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: time {how}, {t[row]:.12g} s after "
            f"{t[row - 1]:.12g} s; sort the log and drop repeated rows."
        )
    longest = float(gaps.max(initial=0.0))
    median = float(np.median(gaps, overwrite_input=True))  # a long log is long enough once
    limit = GAP_IN_MEDIANS * median if max_gap is None else max_gap
    if longest > limit:
        gaps = np.diff(t)
        row = int(np.argmax(gaps > limit)) + 1
        by_default = "ten median intervals" if max_gap is None else "max_gap"
        raise LogError(
            f"{path}, {where(row)}, column `{label}`: a gap of {gaps[row - 1]:.6g} s "
            f"before {t[row]:.12g} s, above the limit of {limit:.6g} s ({by_default}); "
            "split the log there or raise the limit, --max-gap (in Python, `max_gap=`)."
        )
    return median


def _coarse(t: Float[np.ndarray, " N"], gaps: Float[np.ndarray, " n"]) -> str:
    """Why many instants repeat, if they do so because the clock has coarse steps."""
    steps = gaps[gaps > 0]
    if not steps.size or np.mean(gaps == 0) < 0.02:
        return ""
    if np.array_equal(t.astype(np.float32).astype(float), t):
        return "of a clock in single precision"
    least = float(steps.min())
    whole = np.abs(steps / least - np.round(steps / least)).max() < 1e-3
    return f"rounded to {least:.3g} s" if whole else ""
