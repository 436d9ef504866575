"""The chain from a file to a log: read, name and convert, turn, fill, check."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ._checks import check_columns, check_finite, check_rows, check_time
from ._error import Columns, LogError
from ._formats import open_source
from ._frame import ANGLE, Frame
from ._memory import in_memory
from ._missing import MOST, Missing
from ._offset import ROTATING, Offset, check_way, offset_of
from ._select import checked_mapping, doubtful, select
from ._signals import MOTOR, Signals
from ._source import Source

LOOKED_AT = 1_000_000  # rows of a log, from its beginning on, for its offset
KEPT = 1 << 27  # bytes of a log that are kept from the first reading for the second


@dataclasses.dataclass(frozen=True)
class Log:
    """A recorded run of `N` rows.

    - `t`: sampling instants (s), shape `(N,)`, strictly increasing;
    - `u`: mean inputs over `[t[k], t[k+1])`, shape `(N, m)`, the optional ones last where
      the file has them; for a motor the stator voltage (V), m = 2;
    - `y`: outputs at `t[k]`, shape `(N, n)`; for a motor the stator current (A), n = 2;
    - `truth`: the truth columns that the file has, each of shape `(N,)`;
    - `angle`: the electrical angle (rad) that u and y were turned by, shape `(N,)`, of a
      log that was in dq.
    """

    t: Float[np.ndarray, " N"]
    u: Float[np.ndarray, "N m"]
    y: Float[np.ndarray, "N n"]
    truth: Columns
    angle: Float[np.ndarray, " N"] | None = None

    @staticmethod
    def from_columns(
        data: Any,
        signals: Signals = MOTOR,
        *,
        columns: Mapping[str, str] | None = None,
        truth: bool = True,
        max_gap: float | None = None,
        frame: Frame | str = "alpha-beta",
        missing: str = "refuse",
        most_missing: int = MOST,
        remove_offset: str | None = None,
    ) -> "Log":
        """A log from columns in memory, found by name as those of a file are.

        - `data`: a mapping of names to arrays, `(N,)` or, with columns called `name[0]`,
          `name[1]`, `(N, n)`; a pandas `DataFrame`, whose index is a column if it has a
          name; or an xarray `Dataset`, whose variables may have the attribute `units`;
        - `signals`, `columns`, `truth`, `max_gap`, `frame`, `missing`, `most_missing`,
          `remove_offset`: as [`read_log`][] takes them.

        **Raises:** `LogError` as `read_log` does.
        """
        reader = LogReader(
            in_memory(data),
            signals,
            columns=columns,
            truth=truth,
            max_gap=max_gap,
            frame=frame,
            missing=missing,
            most_missing=most_missing,
            remove_offset=remove_offset,
        )
        (log,) = reader.pieces(reader.t.size)
        return log


class LogReader:
    """A log that is read, checked and given piece by piece, so that it need not fit into
    memory. A `Source` may stand for a path.

    - `path`, `signals`, `columns`, `max_gap` (s), `frame`, `missing`, `most_missing`,
      `remove_offset`: as in [`read_log`][], and so is the argument `truth`.

    - `t`: every sampling instant (s), shape `(N,)`; `interval`: the median one (s);
    - `optional`: whether the file has the optional inputs;
    - `truth`: the truth columns that it has;
    - `offset`: what is taken from voltages and currents, if it was to be;
    - `labels`: what the file calls our columns, by our names in its frame;
    - `unread`: truth that is not read since several columns may be it, a line each;
    - `name`: of the file; `said`: what was done of its columns, frame and missing samples,
      a line each, where that is not nothing.

    `watch(log)` is told every batch of the first reading, before time has been checked.

    **Raises:** as [`read_log`][].
    """

    t: Float[np.ndarray, " N"]
    interval: float
    optional: bool
    truth: tuple[str, ...]
    offset: Offset | None
    labels: Mapping[str, str]
    unread: tuple[str, ...]
    said: tuple[str, ...]

    def __init__(
        self,
        path: Path | str | Source,
        signals: Signals = MOTOR,
        *,
        columns: Mapping[str, str] | None = None,
        truth: bool = True,
        max_gap: float | None = None,
        frame: Frame | str = "alpha-beta",
        missing: str = "refuse",
        most_missing: int = MOST,
        remove_offset: str | None = None,
        watch: Callable[[Log], object] = lambda log: None,
    ):
        if max_gap is not None and not max_gap > 0:
            raise LogError(
                "Argument `max_gap` (option --max-gap) must be positive (s), but got "
                f"{max_gap}."
            )
        if remove_offset is not None:
            check_way(remove_offset)
        self.frame = Frame(frame) if isinstance(frame, str) else frame
        self._missing = Missing(missing, most_missing)
        here = self.frame.signals(signals)
        given = dict(columns or {})
        if self.frame.angle is not None:
            given[ANGLE] = self.frame.angle
        mapped = checked_mapping(given, here)
        if not truth:
            signals = dataclasses.replace(signals, truth=())
            here = self.frame.signals(signals)
            mapped = {name: text for name, text in mapped.items() if name in here.names}
        self.path = path.path if isinstance(path, Source) else Path(path)
        self.name = getattr(self.path, "name", str(self.path))
        self.signals = signals
        self._source = path if isinstance(path, Source) else open_source(Path(path))
        self._chosen = select(self._source, here, mapped, self.frame)
        self.labels = {name: column.label for name, column in self._chosen.items()}
        self.unread = doubtful(self._source, here, self._chosen)
        self._sampled = {*signals.inputs, *signals.outputs}
        self.optional = any(name in self._chosen for name in signals.optional)
        if self.optional:
            self._sampled |= {*signals.optional}
        self._kept: list[Columns] | None = []
        self._turned = 0.0  # the largest change of the angle of the frame (rad)
        self.offset = None
        self.t = self._checked(watch, max_gap)
        if remove_offset is not None:
            self.offset = self._offset(remove_offset)
        self.said = tuple(self._lines())

    def _checked(
        self, watch: Callable[[Log], object], max_gap: float | None
    ) -> Float[np.ndarray, " N"]:
        """Every instant, after a look at every value. A log that is not long is kept."""
        source, instants, size = self._source, [], 0
        for data in self._batches(check=True):
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
        label = self.labels["t"]
        self.interval = check_time(self.path, t, label, source.where, max_gap)
        return t

    def _offset(self, way: str) -> Offset:
        names = {*self.signals.inputs, *self.signals.outputs}
        if not names.issuperset(ROTATING):
            raise LogError(
                "--remove-offset (in Python, `remove_offset=`) is for "
                f"{', '.join(ROTATING)}, but this machine has {', '.join(sorted(names))}; "
                "remove it."
            )
        parts: list[list[np.ndarray]] = [[] for _ in ROTATING]
        rows = 0
        for data in self._batches(check=False) if self._kept is None else self._kept:
            for part, name in zip(parts, ROTATING, strict=True):
                part.append(np.asarray(data[name], float))
            rows += data["t"].size
            if rows >= LOOKED_AT:
                break
        ua, ub, ia, ib = (np.concatenate(part) for part in parts)
        return offset_of(self.t[:rows], ua + 1j * ub, ia + 1j * ib, way)

    def _batches(self, *, check: bool) -> Iterator[Columns]:
        """The columns of the log, from the first row on."""
        truths = self.frame.signals(self.signals).truth
        refused = None if self._missing.way == "refuse" else ("t", ANGLE)

        def turned() -> Iterator[Columns]:
            first, last = 0, None
            for data in self._named():
                if check:
                    check_columns(self.path, data, self.labels)
                    if refused is not None:
                        looked = {k: x for k, x in data.items() if k == "t"}
                    else:
                        looked = data
                    check_finite(
                        self.path,
                        looked,
                        self.labels,
                        lambda row, first=first: self._source.where(first + row),
                        truths,
                    )
                    last = self._watch_angle(data, last)
                first += data["t"].size
                yield self.frame.stationary(data)

        kept = {"t", ANGLE, *self.signals.names}
        only = ({k: x for k, x in data.items() if k in kept} for data in turned())
        fill = Missing(self._missing.way, self._missing.most)
        yield from fill.filled(only, self._sampled, self._source.where, str(self.path))
        if check:
            self._missing = fill

    def _named(self) -> Iterator[Columns]:
        """The columns that the file has, by our names and in our units."""
        columns = self._chosen.values()
        wanted = dict.fromkeys(x for column in columns for x in column.sources.values())
        blanks = self._missing.way != "refuse"
        for data in self._source.batches(list(wanted), blanks):
            yield {name: column(data) for name, column in self._chosen.items()}

    def _watch_angle(self, data: Columns, last: float | None) -> float | None:
        """Keeps the largest change of the electrical angle from row to row."""
        if ANGLE not in data or not data["t"].size:
            return last
        angle = self.frame.scale * data[ANGLE]
        steps = np.diff(angle, prepend=angle[0] if last is None else last)
        wrapped = (steps + np.pi) % (2.0 * np.pi) - np.pi
        if np.isfinite(wrapped).any():
            self._turned = max(self._turned, float(np.nanmax(np.abs(wrapped))))
        return float(angle[-1])

    def _lines(self) -> Iterator[str]:
        read = [column.said(name) for name, column in self._chosen.items()]
        if any(read):
            yield f"read: {', '.join(filter(None, read))}"
        yield from self.unread
        if frame := self.frame.said(self.labels.get(ANGLE, ""), self._turned):
            yield f"frame: {frame}"
        if self.offset is not None:
            yield f"offset removed: {self.offset.said()}"
        if missing := self._missing.said(self.t.size):
            yield f"missing: {missing}"

    def pieces(self, rows: int) -> Iterator[Log]:
        """The log in pieces of at most `rows` intervals, each of which begins with the last
        row of the one before; their lengths differ by at most one."""
        intervals = self.t.size - 1
        edges = np.linspace(0, intervals, -(-intervals // rows) + 1).astype(int)
        batches = iter(self._batches(check=False) if self._kept is None else self._kept)
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
        self.truth = tuple(name for name in self.signals.truth if name in data)
        optional = self.signals.optional if self.optional else ()
        if self.offset is not None:
            data = self.offset.taken_from(data)
        return Log(
            t=data["t"],
            u=_stacked(data, [*self.signals.inputs, *optional]),
            y=_stacked(data, self.signals.outputs),
            truth={name: data[name] for name in self.truth},
            angle=data.get(ANGLE),
        )


def read_log(
    path: Path | str,
    signals: Signals = MOTOR,
    *,
    columns: Mapping[str, str] | None = None,
    truth: bool = True,
    max_gap: float | None = None,
    frame: Frame | str = "alpha-beta",
    missing: str = "refuse",
    most_missing: int = MOST,
    remove_offset: str | None = None,
) -> Log:
    """Read the log `path`: text (.csv, .txt, .tsv, .dat, or one of these in .gz), .parquet,
    .npz, .mat, .tdms, or a bag of ROS 1 or 2 (.bag, .mcap, .db3, or its folder).

    - `signals`: the columns to read, by default those of a motor;
    - `columns`: what the file calls a column, `{"u_alpha": "Ualpha"}`, where it is not
      found by its name, or an expression over columns as they are, `{"t": "Time*1e-3"}`;
    - `truth`: whether to read the truth columns;
    - `max_gap`: the longest interval allowed (s), by default ten times the median one;
    - `frame`: that of the file, a [`Frame`][] or its name;
    - `missing`: what to do of a sample of u or y that is blank or not finite: `"refuse"`;
      `"coast"`, which leaves NaN to the observer; or `"interpolate"`, by a straight line
      over at most `most_missing` rows;
    - `remove_offset`: take from stator voltages and currents what is constant in them, told
      from a `"standstill"` of the log or over whole electrical `"periods"`.

    A column is found by its name, with or without a unit (`Time [ms]`, `n (rpm)`, `I_a/A`),
    in the usual spellings; it is converted to SI units, and other columns are ignored. Text
    is UTF-8, separated by commas, semicolons, tabs or blanks; lines before the names,
    comments (#, %, //) and a line of units after the names are understood.

    **Raises:** `LogError` for a sample that is blank, not a number or not finite, for time
    that repeats or runs backwards, for a gap above `max_gap`, for a column that is missing,
    ambiguous or of the wrong shape or unit, for what may be read in two ways. `OSError`
    where the file cannot be opened.
    """
    reader = LogReader(
        path,
        signals,
        columns=columns,
        truth=truth,
        max_gap=max_gap,
        frame=frame,
        missing=missing,
        most_missing=most_missing,
        remove_offset=remove_offset,
    )
    (log,) = reader.pieces(reader.t.size)
    return log


def _stacked(data: Columns, names: Iterable[str]) -> Float[np.ndarray, "N n"]:
    columns = [data[name] for name in names]
    return np.stack(columns, axis=1) if columns else np.zeros((data["t"].size, 0))
