"""A recorded source: a log of one's own, and observers side by side over it."""

import dataclasses
import threading
import tomllib
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._replay import replay
from ..._studies import NAMES, ready_made
from ...diagnosis import Diagnosing, Rows, repaired
from ...logs import Log, LogReader
from ...machines import AbstractDescription
from ...machines._base import Columns, Rates
from ...machines._lifted import NO_EFFECT, is_lifted
from ...observers import Estimate
from ...study import Normal, Spread
from ...study._config import configure
from .. import _table as table
from . import _knobs as knobs
from ._knobs import SPAN, STARTS, Knob
from ._panels import Result, band_of
from ._possible import refuse_impossible, times
from ._programs import POINTS, RUNS, drawn
from ._state import State, StateError

FILE = "machine file"
SUBSTEPS = 4  # as `aslo-jax estimate` has them
BANDS = 20_000  # rows, at most, of a log with a band
USUAL_TOLERANCE = 0.05  # relative deviation of a parameter of which no study says more


class Recorded:
    """A log and its machine.

    - `reader`: of the log; `machine`: as its file has it; `name`: of the log's file.

    At most `PIECE` rows are shown, the first ones; `notes` say so.
    """

    def __init__(self, reader: LogReader, machine: AbstractDescription, name: str) -> None:
        self.reader, self.machine, self.name = reader, machine, name
        self.log = next(iter(reader.pieces(table.PIECE)))
        shown, rows = self.log.t.size, reader.t.size
        cut = f"the first {shown:,} of {rows:,} rows are shown"
        self.notes = (cut,) if shown < rows else ()
        self.variants = dict(_variants(machine))
        self.title = f"{name}: {machine.title}"
        self._chosen: dict[str, tuple[AbstractDescription, Rates]] = {}
        self._lock = threading.Lock()
        self.tolerances = _tolerances(machine)

    def chosen(self, state: State) -> tuple[str, ...]:
        """The observers of a `state`.

        **Raises:** [`StateError`][] for one that is not there.
        """
        for name in state.observers:
            if name not in self.variants:
                raise StateError(
                    f"`observer` must be one of {', '.join(self.variants)}, but is "
                    f"{name[:60]!r}."
                )
        first = tuple(self.variants)[:1]
        return tuple(n for n in self.variants if n in (state.observers or first))

    def _rates(self, name: str) -> tuple[AbstractDescription, Rates]:
        """An observer as `aslo-jax estimate` would make it for this log, and its rates."""
        with self._lock:
            if name not in self._chosen:
                machine = self.variants[name].with_noise_of(self.log)
                self._chosen[name] = machine, machine.rates(self.log)
            return self._chosen[name]

    def knobs(self, state: State) -> list[Knob]:
        """Those of the observers of a `state`."""
        return [*self._knobs(state)]

    def _knobs(self, state: State) -> Any:
        for name in self.chosen(state):
            machine, rates = self._rates(name)
            fields, group = type(machine.observer).model_fields, f"Gains of {name}"
            key = f"observers.{name}.".__add__
            if "start" in fields and not is_lifted(machine.observer):
                start = machine.observer.start
                scale: dict[str, Any] = {"scale": "choice", "options": STARTS}
                yield Knob(key("start"), "start", group, start, **scale)
            for each, rate in rates.items():
                if isinstance(rate.value, float | int):
                    low, high = rate.value / SPAN, rate.value * SPAN
                    if each == "pll_bandwidth":
                        high = min(high, 0.5 / float(np.median(np.diff(self.log.t))))
                    label = each.replace("_", " ").replace("pll", "loop")
                    value = min(float(rate.value), high)
                    limits: dict[str, Any] = {"low": low, "high": high, "scale": "log"}
                    yield Knob(key(each), label, group, value, "rad/s", **limits)
            value = machine.observer.threshold
            low, high = value / SPAN, min(value * SPAN, 0.99)
            limits = {"low": low, "high": high, "scale": "log"}
            yield Knob(key("threshold"), "threshold", group, value, "", **limits)
        yield from self._of_log()
        for each in type(self.machine.machine).model_fields:
            value = getattr(self.machine.machine, each)
            if each != "inertia" and knobs.nonzero(value):
                label, group = each.replace("_", " "), "Parameter errors"
                limits = {"low": -knobs.ERRORS, "high": knobs.ERRORS}
                yield Knob(f"error.{each}", label, group, 0.0, "1", **limits)

    def _of_log(self) -> Any:
        """Noise and offsets, in shares of the signals."""
        of = self.machine.signals
        names = (*of.inputs, *of.optional)[: self.log.u.shape[1]]
        for place, columns, x in (
            ("sensor", of.outputs, self.log.y),
            ("input_sensor", names, self.log.u),
        ):
            size = float(f"{0.2 * np.sqrt(np.nanmean(np.square(x))):.1g}") or 1.0
            what = "outputs" if place == "sensor" else "inputs"
            limits: dict[str, Any] = {"low": 1e-4 * size, "high": size, "scale": "zero-log"}
            yield Knob(f"noise.{place}", f"more, of the {what}", "Noise", 0.0, "", **limits)
            for k, column in enumerate(columns):
                key = f"offset.{place}.{k}"
                yield Knob(key, column, "Offsets", 0.0, "", -size, size)

    def moved(self, state: State) -> tuple[dict[str, float | str], Log]:
        """The value of every knob, and the log with noise and offsets."""
        values = knobs.settings(self.knobs(state), state.values)
        u, y = self.log.u.copy(), self.log.y.copy()
        random = np.random.default_rng([state.seed, 1])
        for place, x in (("sensor", y), ("input_sensor", u)):
            deviation = float(values[f"noise.{place}"])
            if deviation:
                x += deviation * random.standard_normal(x.shape)
            for k in range(x.shape[1]):
                x[:, k] += float(values[f"offset.{place}.{k}"])
        return values, dataclasses.replace(self.log, u=u, y=y)

    def described(self, state: State, name: str) -> AbstractDescription:
        """The machine with an observer of a `state`, every rate stated.

        **Raises:** [`StateError`][] for an observer that is not there.
        """
        if name not in self.chosen(state):
            raise StateError(f"There is no observer {name[:60]!r} here.")
        values = knobs.settings(self.knobs(state), state.values)
        machine, rates = self._rates(name)
        keys: dict[str, Any] = {k: rate.value for k, rate in rates.items()}
        for key, value in values.items():
            owner, _, last = key.rpartition(".")
            if owner == f"observers.{name}":
                keys[last] = value
        errors = {
            key.removeprefix("error."): float(value)
            for key, value in values.items()
            if key.startswith("error.") and value
        }
        if errors:
            refuse_impossible(machine.machine.model_dump(), errors)
        parameters = {
            key: times(getattr(machine.machine, key), 1.0 + error)
            for key, error in errors.items()
        }
        return _with(machine, keys, parameters)

    def substeps(self, machine: AbstractDescription) -> int:
        """As `aslo-jax estimate` has them."""
        return 1 if is_lifted(machine.observer) else SUBSTEPS

    def result(self, state: State) -> Result:
        """Every observer over the log, as `aslo-jax estimate` runs it."""
        _, log = self.moved(state)
        tables, notes = {}, set()
        machine = self.described(state, self.chosen(state)[0])
        for name in self.chosen(state):
            described = self.described(state, name)
            suspect = self._suspect(described, log)
            if suspect.count:
                notes.add(f"{suspect.count} rows cannot be right and were repaired")
            right = repaired(log, suspect)
            columns = _estimated(described, right, suspect, self.substeps(described))
            tables[name] = _tidy(described, columns)
        return Result(log, tables, machine, None, (*self.notes, *sorted(notes)))

    def _suspect(self, machine: AbstractDescription, log: Log) -> Rows:
        circles = [
            c.read_from(self.reader.frame, self.reader.labels) for c in machine.circles()
        ]
        return Diagnosing(circles, log.t.size, self.reader.interval, 0.0).add(log)

    def band(self, state: State) -> dict[str, Any]:
        """How far the estimates of observers that take the parameters for others, by the
        tolerances of the machine, are from the truth, or from the estimate where there is
        none."""
        _, log = self.moved(state)
        if log.t.size > BANDS:
            note = f"no band: the log has more than {BANDS:,} rows"
            return {"t": "", "bands": {}, "note": note}
        every = max(1, log.t.size // POINTS)
        found: dict[str, np.ndarray] = {}
        for name in self.chosen(state):
            machine = self.described(state, name)
            rates = machine.rates_of(None)
            draws = drawn(self.tolerances, state.seed)
            given = machine.machine.model_dump()
            refuse_impossible(given, {}, draws, state.tolerance)
            many = [
                _spread(machine, draws, state.tolerance, k).state_observer(rates)
                for k in range(RUNS)
            ]
            values = _replayed(many, log, self.substeps(machine))
            found[name] = self._norm(machine, log, values)[:, ::every]
        return band_of(log.t[::every], found)

    def _norm(
        self, machine: AbstractDescription, log: Log, values: np.ndarray
    ) -> np.ndarray:
        blank = Result(log, {}, machine)
        entries = list(blank.entries())
        truth = machine.truth(log)
        if all(e in truth for e in entries):
            about = np.stack([truth[e] for e in entries], axis=1)
        else:
            about = np.median(values[:, :, : len(entries)], axis=0)
        return np.sqrt(np.sum(np.square(values[:, :, : len(entries)] - about), axis=2))


def _variants(machine: AbstractDescription) -> Any:
    """The file's observer, and others that its kind offers, by name."""
    yield FILE, machine
    fields = type(machine.observer).model_fields
    table_of = type(machine.observer)
    lifted = getattr(fields.get("kind"), "annotation", None)
    kinds = getattr(lifted, "__args__", ())
    stated = machine.observer.model_dump(exclude_unset=True)
    plain = {k: v for k, v in stated.items() if k in ("cutoff", "pll_bandwidth")}

    def make(**keys: Any) -> AbstractDescription:
        own = {k: v for k, v in plain.items() if "kind" not in keys or k not in NO_EFFECT}
        return machine.model_copy(update={"observer": table_of(**own | keys)})

    if stated.keys() - plain.keys():
        yield "ASLO", make()
    if "start" in fields:
        yield "ASLO, printed start", make(start="paper")
    if "gain" in fields:
        yield "A-ASLO", make(gain=20.0)
    if not machine.finds_noise:
        return
    if "lifted_kalman" in kinds and "start" in fields:
        yield "Kalman", make(kind="lifted_kalman")
    if "adaptive" in kinds:
        yield "Adaptive Kalman", make(kind="adaptive")


def _with(
    machine: AbstractDescription, keys: Mapping[str, Any], parameters: Mapping[str, Any]
) -> AbstractDescription:
    """With other keys of `[observer]` and values of `[machine]`."""
    known = type(machine.observer).model_fields
    keys = {k: v for k, v in keys.items() if k in known}
    return machine.model_copy(
        update={
            "observer": machine.observer.model_copy(update=keys),
            "machine": machine.machine.model_copy(update=dict(parameters)),
        }
    )


def _estimated(
    machine: AbstractDescription, log: Log, suspect: Rows, substeps: int
) -> Columns:
    """The table of `aslo-jax estimate`."""
    rates = machine.rates_of(None)
    estimator = table.Estimator(machine, rates, log.t, substeps)
    columns = estimator(log, suspect).columns
    if estimator.complete:
        return columns
    return table.Estimator(machine, rates, log.t, substeps, 0)(log, suspect).columns


def _tidy(machine: AbstractDescription, columns: Columns) -> Columns:
    """With one certificate, the least, and one flag for all."""
    suffixes = machine.suffixes()
    least = np.min([columns[f"certificate{s}"] for s in suffixes], axis=0)
    any_one = np.max([columns[f"coasting{s}"] for s in suffixes], axis=0)
    return columns | {"certificate": least, "coasting": any_one}


def _tolerances(machine: AbstractDescription) -> Spread:
    """How well the parameters are known: as the ready-made study of the kind has it, else
    normally to `USUAL_TOLERANCE`."""
    known = type(machine.machine).model_fields
    if machine.kind in NAMES:
        whole = configure(tomllib.loads(ready_made(machine.kind))).spread.parameters
        where = lambda p: [p.where] if isinstance(p.where, str) else list(p.where)
        own = {
            n: p
            for n, p in whole.items()
            if p.relative and all(w.removeprefix("plant.") in known for w in where(p))
        }
        if own:
            return Spread(own)
    usual = Normal(1.0, USUAL_TOLERANCE, low=0.5, high=1.5)
    names = [n for n in machine.unknowns.usual if n in known]
    return Spread({n: (f"plant.{n}", usual) for n in names})


def _spread(
    machine: AbstractDescription, draws: list[Any], tolerance: float, run: int
) -> AbstractDescription:
    """The machine with the parameters of a run."""
    new = {}
    for where, values in draws:
        key = where.removeprefix("plant.")
        factor = 1.0 + tolerance * (float(values[run]) - 1.0)
        new[key] = times(getattr(machine.machine, key), factor)
    return machine.model_copy(update={"machine": machine.machine.model_copy(update=new)})


def _replayed(observers: list[Any], log: Log, substeps: int) -> np.ndarray:
    """The values of the estimates of every observer, shape `(runs, N, n)`."""
    arrays = [eqx.partition(each, eqx.is_array) for each in observers]
    still = arrays[0][1]
    stacked = jax.tree.map(lambda *x: np.stack(x), *[each for each, _ in arrays])
    return np.asarray(_many(stacked, still, log, substeps))


def _many(stacked: Any, still: Any, log: Log, substeps: int) -> Any:
    def one(leaves: Any) -> Any:
        observer = eqx.combine(leaves, still)
        found = replay(observer, log.t, log.u, log.y, substeps=substeps, engine="fused")
        leaf = lambda x: isinstance(x, Estimate)
        each = jax.tree.leaves(found, is_leaf=leaf)
        return jnp.concatenate([e.value for e in each if leaf(e)], axis=-1)

    return jax.vmap(one)(stacked)
