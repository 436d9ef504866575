"""Samples that are missing in a log."""

from collections.abc import Iterable, Iterator

import numpy as np

from ._error import Columns, LogError, Where

WAYS = ("refuse", "coast", "interpolate")
MOST = 10  # rows that are interpolated at a stretch


class Missing:
    """What is done of rows in which a sample is not finite: nothing, by `"refuse"`, which
    the look at every value does, and by `"coast"`, which leaves them to the observer; or
    `"interpolate"`, a straight line over at most `most` rows.

    - `rows`: how many had one; `longest`: how many of these were next to each other.
    """

    def __init__(self, way: str = "refuse", most: int = MOST):
        if way not in WAYS:
            raise LogError(
                f"Argument `missing` (option --missing) must be one of {', '.join(WAYS)}, "
                f"but is {way!r}."
            )
        if most < 1:
            raise LogError(
                "Argument `most_missing` (option --most-missing) must be at least 1 row, "
                f"but is {most}."
            )
        self.way, self.most = way, most
        self.rows, self.longest, self._run = 0, 0, 0

    def filled(
        self, batches: Iterable[Columns], signals: set[str], where: Where, label: str
    ) -> Iterator[Columns]:
        """The batches, with what is missing in the columns `signals` filled.

        **Raises:** `LogError` for a stretch of more rows, or one at an end of the log."""
        if self.way == "refuse":
            yield from batches
            return
        self.rows, self.longest, self._run = 0, 0, 0
        held: Columns = {}
        first = 0  # the row that `held`, or the next batch, begins with
        for batch in batches:
            bad = _bad(batch, signals)
            self._count(bad)
            if self.way == "coast":
                yield batch
                continue
            whole = (
                {k: np.concatenate([held[k], x]) for k, x in batch.items()}
                if held
                else batch
            )
            bad = _bad(whole, signals)
            good = np.flatnonzero(~bad)
            if not good.size:
                held = whole
                self._refuse_long(bad.size, first, where, label)
                continue
            if bad[0]:
                raise _at_an_end(f"{label}, {where(first)}")
            self._fill(whole, signals, bad, good, first, where, label)
            # The last good row, and what comes after it, is for the next batch.
            last = int(good[-1])
            held = {k: x[last:] for k, x in whole.items()}
            if last:
                yield {k: x[:last] for k, x in whole.items()}
            first += last
        if held and (bad := _bad(held, signals)).any():
            raise _at_an_end(f"{label}, {where(first + int(np.argmax(bad)))}")
        if held:
            yield held

    def _count(self, bad: np.ndarray) -> None:
        self.rows += int(bad.sum())
        edges = np.flatnonzero(np.diff(np.r_[False, bad, False]))
        for begin, end in edges.reshape(-1, 2):
            length = int(end - begin) + (self._run if begin == 0 else 0)
            self.longest = max(self.longest, length)
            self._run = length if end == bad.size else 0
        if bad.size and not bad[-1]:
            self._run = 0

    def _fill(
        self,
        columns: Columns,
        signals: set[str],
        bad: np.ndarray,
        good: np.ndarray,
        first: int,
        where: Where,
        label: str,
    ) -> None:
        if not bad.any():
            return
        gaps = np.diff(good) - 1
        if (gaps > self.most).any():
            k = int(np.argmax(gaps > self.most))
            self._refuse_long(int(gaps[k]), first + int(good[k]) + 1, where, label)
        t, inside = columns["t"], slice(None, int(good[-1]) + 1)
        for name in signals:
            x = columns[name][inside]
            lost = ~np.isfinite(x)
            if lost.any():
                filled = x.copy()
                filled[lost] = np.interp(t[inside][lost], t[inside][~lost], x[~lost])
                columns[name] = np.concatenate([filled, columns[name][inside.stop :]])

    def _refuse_long(self, rows: int, first: int, where: Where, label: str) -> None:
        if rows > self.most:
            raise LogError(
                f"{label}, {where(first)}: samples are missing in {rows} rows or more from "
                f"here on, but at most {self.most} are interpolated; raise --most-missing "
                "(in Python, `most_missing=`), or --missing coast."
            )

    def said(self, rows: int) -> str:
        """What was missing, in words; nothing where nothing was."""
        if not self.rows:
            return ""
        done = {"coast": "left to the observer, which coasts over them"}
        return (
            f"{self.rows} of {rows} rows with a sample that is missing, at most "
            f"{self.longest} next to each other, "
            + done.get(self.way, "interpolated by straight lines")
        )


def _bad(columns: Columns, signals: set[str]) -> np.ndarray:
    bad = np.zeros(columns["t"].size, bool)
    for name in signals:
        bad |= ~np.isfinite(columns[name])
    return bad


def _at_an_end(place: str) -> LogError:
    return LogError(
        f"{place}: samples are missing at an end of the log, where nothing is to "
        "interpolate from; remove these rows, or --missing coast."
    )
