"""What `aslo-jax estimate` says of a log: figures of the estimates, and warnings."""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from ..diagnosis import of_stamps
from ..logs import LogReader
from ..machines import AbstractDescription, Quantity
from ..machines._base import Rates, relative
from ..machines._lifted import is_adaptive, is_lifted, limit_of, said_of
from ._table import Piece


@dataclasses.dataclass
class _Squares:
    """The root mean square of numbers that come piece by piece, without those that are not
    finite."""

    total: float = 0.0
    count: int = 0

    def add(self, x: Float[np.ndarray, " N"]) -> None:
        x = x[np.isfinite(x)]
        self.total += float(np.sum(x**2))
        self.count += x.size

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.total / max(self.count, 1)))


@dataclasses.dataclass
class _Errors:
    """Bias and scatter of errors that come piece by piece: mean and standard deviation, of
    angles the circular ones (Mardia and Jupp, *Directional Statistics*, 2.3)."""

    angle: bool
    count: int = 0
    total: complex = 0j
    squares: float = 0.0

    def add(self, error: Float[np.ndarray, " N"]) -> None:
        error = error[np.isfinite(error)]
        self.count += error.size
        self.total += complex(np.sum(np.exp(1j * error) if self.angle else error))
        self.squares += float(np.sum(error**2))

    @property
    def bias(self) -> float:
        mean = self.total / max(self.count, 1)
        return float(np.angle(mean)) if self.angle else mean.real

    @property
    def scatter(self) -> float:
        mean = self.total / max(self.count, 1)
        if self.angle:
            return float(np.sqrt(max(-2.0 * np.log(max(abs(mean), 1e-300)), 0.0)))
        return float(np.sqrt(max(self.squares / max(self.count, 1) - mean.real**2, 0.0)))


INCONSISTENT = "inconsistent"  # a kind of warning, which the verdict on a log has, too
FAR_OFF = 0.3  # of the magnet flux: no right log is off by that


class Summary:
    """Figures of a table of estimates that comes piece by piece.

    They count the settled rows: from ten time constants after the first certified estimate
    on, or from that one in a short log. The time constant is that of loop and gain, which
    forget their start, or else of the fastest filter. For a median, one number for each of
    these rows is kept.
    """

    def __init__(
        self,
        reader: LogReader,
        machine: AbstractDescription,
        rates: Rates,
        substeps: int,
        noise: Mapping[str, str] | None = None,
        smoothed: bool = False,
    ) -> None:
        self.noise, self.smoothed = noise or {}, smoothed
        self.reader, self.machine = reader, machine
        self.rates, self.substeps = rates, substeps
        self.interval = reader.interval
        self.coasting = dict.fromkeys(machine.suffixes(), 0)
        self.infinite = 0  # rows with a number that is not finite
        self.infinite_columns: set[str] = set()
        self.settled: dict[str, float] = {}  # from when on (s), by suffix
        self.scored = False
        self.relative: dict[str, list[Float[np.ndarray, " n"]]] = {}
        self.offsets: dict[str, float] = {}  # removed from errors (rad), by column
        self.errors: dict[str, _Errors] = {}
        self.sizes: dict[str, _Squares] = {}
        self.all_sizes: dict[str, _Squares] = {}

    def add(self, piece: Piece) -> None:
        t, self.scored = piece.columns["t"], bool(piece.truth)
        self._count(piece)
        for suffix in self.coasting:
            coasting = piece.columns[f"coasting{suffix}"]
            self.coasting[suffix] += int(coasting.sum())
            if suffix not in self.settled and not coasting.all():
                self.settled[suffix] = self._settled(t[np.argmin(coasting)])
        for quantity in self.machine.quantities:
            rows = t >= self.settled.get(quantity.suffix, np.inf)
            self._score(quantity, piece, rows)

    def _count(self, piece: Piece) -> None:
        """Rows with numbers that are not finite, but errors where there is no truth."""
        rows = np.zeros(piece.columns["t"].size, bool)
        for name, column in piece.columns.items():
            bad = ~np.isfinite(column)
            true = piece.truth.get(name.removeprefix("error_"))
            if name.startswith("error_") and true is not None:
                bad &= np.isfinite(true)
            if bad.any():
                self.infinite_columns.add(name)
                rows |= bad
        self.infinite += int(rows.sum())

    def _settled(self, start: float) -> float:
        loops = [self.rates[k].least for k in ("gain", "pll_bandwidth") if k in self.rates]
        every = [rate.least for rate in self.rates.values()]
        if not every:  # a Kalman filter that no loop follows has nothing to forget
            return start
        rate = min(loops) if loops else max(every)
        after = start + 10.0 / rate
        return after if self.reader.t[-1] >= after else start

    def _score(self, quantity: Quantity, piece: Piece, rows: np.ndarray) -> None:
        kept = self.relative.setdefault(quantity.name, [])
        if quantity.name in piece.residuals:
            trusted = piece.columns[f"coasting{quantity.suffix}"] == 0
            kept.append(piece.residuals[quantity.name][rows & trusted])
        elif set(quantity.columns) <= piece.truth.keys() and len(quantity.columns) > 1:
            kept.append(relative_error(quantity, piece)[rows])
        else:
            for name in filter(piece.truth.__contains__, quantity.columns):
                error = self.errors.setdefault(name, _Errors(quantity.angle))
                error.add(piece.columns[f"error_{name}"][rows])
                for sums, x in (
                    (self.sizes, piece.truth[name][rows]),
                    (self.all_sizes, piece.truth[name]),
                ):
                    sums.setdefault(name, _Squares()).add(x)

    def biases(self) -> dict[str, float]:
        """The mean errors of the angles (rad), by column."""
        angles = [q.columns[0] for q in self.machine.quantities if q.angle]
        return {n: self.errors[n].bias for n in angles if n in self.errors}

    def lines(self) -> Iterator[str]:
        t, settings, signals = self.reader.t, self.machine.observer, self.machine.signals
        yield (
            f"{self.reader.name}: {t.size} rows, {t[-1] - t[0]:.6g} s, median "
            f"interval {1e3 * self.interval:.4g} ms"
        )
        yield from self.reader.said
        if signals.optional and not self.reader.optional:
            yield f"not in the log, taken as zero: {', '.join(signals.optional)}"
        keys = ["saliency", "kind" if is_lifted(settings) else "completion"]
        names = [name for key in keys if (name := getattr(settings, key, ""))]
        if not is_lifted(settings):
            names.append(f"{getattr(settings, 'start', 'exact')} start")
        if is_adaptive(settings):
            names.append(f"unknown {' and '.join(settings.parameters)}")
        else:
            names.append(f"threshold {limit_of(settings):g}")
        yield (
            f"observer for {self.machine.kind}: {', '.join(names)}, "
            f"{self.substeps} substep"
            + ("s" if self.substeps > 1 else "")
            + (", smoothed over the whole log" if self.smoothed else "")
        )
        if is_lifted(settings):
            yield from said_of(settings, self.machine.noise_units(), self.noise)
        for name, rate in self.rates.items():
            yield f"  {name} {rate}" + (f" ({rate.reason})" if rate.reason else "")
        for suffix, rows in self.coasting.items():
            yield f"coasting{suffix}: {100 * (rows / t.size):.3g} % of the rows ({rows})"
        if self.scored:
            yield "against the truth columns:"
        elif any(self.relative.values()):
            yield f"consistency, {self.machine.residual}:"
        for quantity in self.machine.quantities:
            if quantity.suffix in self.settled:
                since = t[np.searchsorted(t, self.settled[quantity.suffix])]
                for text in self._lines(quantity):
                    yield f"  {quantity.name}, from {since:.6g} s on: {text}"

    def _lines(self, quantity: Quantity) -> Iterator[str]:
        if kept := self.relative.get(quantity.name):
            of = "relative error, " if self.scored else ""
            x = np.concatenate(kept)
            x = x[~np.isnan(x)]  # where the truth is missing
            if not x.size:
                return
            of += "rows that coast left out, " * (not self.scored)
            largest = x.max()
            middle = np.median(x, overwrite_input=True)
            yield f"{of}median {middle:.2g}, max {largest:.2g}"
        for name in filter(self.errors.__contains__, quantity.columns):
            error, which = self.errors[name], f"{name}: " * (len(quantity.columns) > 1)
            bias, scatter = error.bias, error.scatter
            if quantity.angle:
                text = f"bias {np.degrees(bias):.3g}, scatter {np.degrees(scatter):.2g}"
                removed = self.offsets.get(name)
                if removed is not None:
                    text += f", after a bias of {np.degrees(removed):.4g} was removed"
                yield f"error, {text} electrical degrees"
            else:
                size = self.sizes[name].rms
                yield (
                    f"{which}error, bias {bias:.2g}, scatter {scatter:.2g} "
                    f"{quantity.unit} (of {size:.3g})"
                )

    def warnings(self) -> Iterator[tuple[str, str]]:
        """Kind and message of each."""
        sampled = f"{1.0 / self.interval:.4g} rows a second"
        units = [
            f.kind for f in of_stamps(self.reader.t, self.machine.longest_interval).warnings
        ]
        if self.interval > self.machine.longest_interval and "time_unit" not in units:
            yield (
                "slow_sampling",
                f"the log has {sampled}, which is slow for this kind of machine: is `t` in "
                "seconds, not milliseconds?",
            )
        if self.infinite:
            names = sorted(self.infinite_columns)
            yield (
                "not_finite",
                f"{self.infinite} of {self.reader.t.size} rows of the table hold numbers "
                f"that are not finite, in {', '.join(names)}: the log's numbers are "
                "too large or too small to be squared; check its units",
            )
        for suffix, rows in self.coasting.items():
            share = rows / self.reader.t.size
            which = " and ".join(
                q.name for q in self.machine.quantities if q.suffix == suffix
            )
            checks = (
                f"{self.machine.motion} Check too that `t` is in seconds ({sampled}), the "
                "parameters, and the cutoff, which may be far from the frequencies of the "
                "log."
            )
            if suffix not in self.settled:
                yield (
                    "not_certified",
                    f"no estimate is certified in this log, {which} cannot be observed in "
                    f"it: {checks}",
                )
            elif share > 0.5:
                text = f"{100 * share:.3g} % of the rows coast ({which}): {checks}"
                yield "mostly_coasting", text
        yield from self._off()

    def _off(self) -> Iterator[tuple[str, str]]:
        """What is said of estimates that miss their model by far in every other row."""
        if self.scored or not self.machine.circles():
            return
        for name, kept in self.relative.items():
            x = np.concatenate(kept) if kept else np.zeros(0)
            middle = np.median(x, overwrite_input=True) if x.size else 0.0
            if not middle <= FAR_OFF:
                yield (
                    INCONSISTENT,
                    f"the {name} does not fit the model of the machine: "
                    f"{self.machine.residual} has the median {middle:.2g}; check the "
                    "parameters and their units, and scale and sign of the signals",
                )


def relative_error(quantity: Quantity, piece: Piece) -> Float[np.ndarray, " N"]:
    """`|error| / |truth|` of a vector, row by row."""
    error = np.stack([piece.columns[f"error_{name}"] for name in quantity.columns])
    truth = np.stack([piece.truth[name] for name in quantity.columns])
    return relative(np.linalg.norm(error, axis=0), np.linalg.norm(truth, axis=0))
