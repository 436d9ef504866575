"""What `aslo-jax estimate` says of a log: figures of the estimates, and warnings."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ..logs import LogReader
from ..machines import AbstractDescription, Quantity
from ..machines.base import Rates, relative
from .table import Piece


@dataclasses.dataclass
class _Squares:
    """The root mean square of numbers that come piece by piece."""

    total: float = 0.0
    count: int = 0

    def add(self, x: Float[np.ndarray, " N"]) -> None:
        self.total += float(np.sum(x**2))
        self.count += x.size

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.total / max(self.count, 1)))


class Summary:
    """Figures of a table of estimates that comes piece by piece.

    They count the settled rows: from ten time constants after the first certified estimate
    on, or from that one in a short log. The time constant is that of loop and gain, which
    forget their start, or else of the fastest filter. For a median, one number for each of
    these rows is kept.
    """

    def __init__(
        self, reader: LogReader, machine: AbstractDescription, rates: Rates, substeps: int
    ):
        self.reader, self.machine = reader, machine
        self.rates, self.substeps = rates, substeps
        self.interval = reader.interval
        self.coasting = dict.fromkeys(machine.suffixes(), 0)
        self.settled: dict[str, float] = {}  # from when on (s), by suffix
        self.scored = False
        self.relative: dict[str, list[Float[np.ndarray, " n"]]] = {}
        self.errors: dict[str, _Squares] = {}
        self.sizes: dict[str, _Squares] = {}
        self.all_sizes: dict[str, _Squares] = {}

    def add(self, piece: Piece) -> None:
        t, self.scored = piece.columns["t"], bool(piece.truth)
        for suffix in self.coasting:
            coasting = piece.columns[f"coasting{suffix}"]
            self.coasting[suffix] += int(coasting.sum())
            if suffix not in self.settled and not coasting.all():
                self.settled[suffix] = self._settled(t[np.argmin(coasting)])
        for quantity in self.machine.quantities:
            rows = t >= self.settled.get(quantity.suffix, np.inf)
            self._score(quantity, piece, rows)

    def _settled(self, start: float) -> float:
        loops = [self.rates[k].value for k in ("gain", "pll_bandwidth") if k in self.rates]
        rate = min(loops) if loops else max(rate.value for rate in self.rates.values())
        after = start + 10.0 / rate
        return after if self.reader.t[-1] >= after else start

    def _score(self, quantity: Quantity, piece: Piece, rows: np.ndarray) -> None:
        kept = self.relative.setdefault(quantity.name, [])
        if quantity.name in piece.residuals:
            kept.append(piece.residuals[quantity.name][rows])
        elif not set(quantity.columns) <= piece.truth.keys():
            return
        elif len(quantity.columns) > 1:
            kept.append(relative_error(quantity, piece)[rows])
        else:
            name = next(iter(quantity.columns))
            for sums, x in (
                (self.errors, piece.columns[f"error_{name}"][rows]),
                (self.sizes, piece.truth[name][rows]),
                (self.all_sizes, piece.truth[name]),
            ):
                sums.setdefault(name, _Squares()).add(x)

    def lines(self) -> Iterator[str]:
        t, settings, signals = self.reader.t, self.machine.observer, self.machine.signals
        yield (
            f"{self.reader.path.name}: {t.size} rows, {t[-1] - t[0]:.6g} s, median "
            f"interval {1e3 * self.interval:.4g} ms"
        )
        if signals.optional and not self.reader.optional:
            yield f"not in the log, taken as zero: {', '.join(signals.optional)}"
        names = [getattr(settings, key, "") for key in ("saliency", "completion")]
        yield (
            f"observer for {self.machine.kind}: {''.join(f'{n}, ' for n in names if n)}"
            f"{getattr(settings, 'start', 'exact')} start, threshold "
            f"{settings.threshold:g}, {self.substeps} substep"
            + ("s" if self.substeps > 1 else "")
        )
        for name, (rate, reason) in self.rates.items():
            yield f"  {name} {rate:.4g} rad/s" + (f" ({reason})" if reason else "")
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
            largest = x.max()
            middle = np.median(x, overwrite_input=True)
            yield f"{of}median {middle:.2g}, max {largest:.2g}"
        elif quantity.columns[0] in self.errors:
            (name,) = quantity.columns
            error, size = self.errors[name].rms, self.sizes[name].rms
            if quantity.angle:
                yield f"error, rms {np.degrees(error):.2g} electrical degrees"
            else:
                yield f"error, rms {error:.2g} {quantity.unit} (of {size:.3g})"

    def warnings(self) -> Iterator[str]:
        sampled = f"{1.0 / self.interval:.4g} rows a second"
        if self.interval > self.machine.longest_interval:
            yield (
                f"the log has {sampled}, which is slow for this kind of machine: is `t` in "
                "seconds, not milliseconds?"
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
                    f"no estimate is certified in this log, {which} cannot be observed in "
                    f"it: {checks}"
                )
            elif share > 0.5:
                yield f"{100 * share:.3g} % of the rows coast ({which}): {checks}"


def relative_error(quantity: Quantity, piece: Piece) -> Float[np.ndarray, " N"]:
    """`|error| / |truth|` of a vector, row by row."""
    error = np.stack([piece.columns[f"error_{name}"] for name in quantity.columns])
    truth = np.stack([piece.truth[name] for name in quantity.columns])
    return relative(np.linalg.norm(error, axis=0), np.linalg.norm(truth, axis=0))
