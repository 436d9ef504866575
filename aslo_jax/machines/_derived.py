"""`kind = "derived"`: any system, written in Python as a model."""

import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, model_validator

from .._filters import LowPass
from ..derivation import Derived
from ..logs import Log, Signals
from ..observers import AbstractObserver, AlgebraicObserver
from ..schema import NonNegative, Positive
from . import _keys as keys, _lifted
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    MachineError,
    Quantity,
    Rate,
    Rates,
    Unknowns,
    certified,
    in_columns,
    over_window,
    relative,
)
from ._condensed import CondensedLog
from ._derived_study import (
    STUDY,
    THRESHOLD,
    DerivedTable,
    slowest_of,
    state_observer,
)
from ._frequency import cutoff_for_positions
from ._study import Study

FASTER = 1.5  # than the slowest filter that the relation allows
WINDOW = 100  # rows over which states are compared with their rates
EXAMPLE = Layout(
    Signals(
        ("voltage",),
        ("current",),
        truth=("speed_true",),
        note="here those of an example: the model decides",
    ),
    (Quantity("speed", ("speed",), "rad/s"),),
)


_PARAMETERS, _DEVIATIONS, _DRIFT, _HOLD, _BANK, _TOLERANCE = _lifted.adaptive_keys((), ())


class DerivedObserverTable(_lifted.ObserverTable):
    """`[observer]` of a derived relation, all optional but for an adaptive one."""

    kind: _lifted.MotorKind = _lifted.kind_key()
    cutoff: Positive | None = keys.cutoff(example=30.0)
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold(THRESHOLD)
    output_deviation: _lifted.Deviation | None = _lifted.deviation_key("outputs", 0.01)
    input_deviation: _lifted.Deviation | None = _lifted.deviation_key("inputs", 0.01)
    parameters: list[str] = _PARAMETERS
    deviations: list[Positive] = _DEVIATIONS
    drift: NonNegative = _DRIFT
    hold: Positive = _HOLD
    bank: Annotated[int, Field(ge=3)] = _BANK
    tolerance: Positive = _TOLERANCE


class DerivedDescription(AbstractDescription[DerivedTable, DerivedObserverTable]):
    """A system of one's own, whose observer is derived from its model. Reading its
    description runs the module that `model` names, which may lie beside the TOML file.

    **Raises:** `ValueError` where the module cannot be run, gives no model, or one from
    which no relation can be derived.
    """

    machine: DerivedTable
    observer: DerivedObserverTable = DerivedObserverTable()

    kind = "derived"
    title: ClassVar[str] = "System of one's own"
    layout: ClassVar[Layout] = EXAMPLE
    motion = "do its inputs and outputs vary?"
    residual: ClassVar[str] = (
        "| change of x - integral of its rate | / (integral of |rate| + |x|), in 100 rows"
    )
    refused: ClassVar[Mapping[str, str]] = {
        "pll_bandwidth": "no loop follows an angle; remove it",
    }
    longest_interval: ClassVar[float] = 10.0
    memory: ClassVar[int] = WINDOW
    unknowns: ClassVar[Unknowns] = Unknowns(usual=("parameters",))
    telling: ClassVar[tuple[str, str]] = (
        "inputs that vary more, or others of them that are known (option --parameter), "
        "where only their ratios matter",
        "a log that varies more",
    )
    study: ClassVar[Study | None] = STUDY

    @model_validator(mode="after")
    def _adapts(self):
        """Refuse unknown parameters that its relation does not have."""
        if not _lifted.is_adaptive(self.observer):
            return self
        if not self.observer.parameters:
            raise ValueError(
                "`observer.parameters` must name what is not known with `observer.kind = "
                f'"{_lifted.ADAPTIVE}"` of a model, and `observer.deviations` by how much'
            )
        try:
            self.found().adaptive_filter(
                1.0,
                1.0,
                parameters=self.observer.parameters,
                deviations=tuple(self.observer.deviations),
            )
        except ValueError as error:
            raise ValueError(f"`observer.parameters`: {error}") from error
        return self

    def found(self) -> Derived:
        """What was derived."""
        return self.machine.found()

    def plant(self) -> Any:
        return self.found().plant()

    def offered(self) -> Unknowns:
        known = tuple(self.found().model.known)
        none = "" if known else "its model has no parameters that are known"
        return Unknowns(known, refused=none)

    def constants(self) -> Mapping[str, Any]:
        return self.found().model.known

    def constant_units(self) -> Mapping[str, str]:
        model = self.found().model
        return {name: model.unit(name) for name in model.known}

    def in_file(self, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        if self.machine.parameters:
            return {"machine.parameters": dict(values)}
        return {"machine": {"parameters": dict(values)}} if values else {}

    def fitted(self, log: Log, given: Mapping[str, float]) -> Any:
        """The plant, or where the model does not give the outputs, its relation alone."""
        found = self.found()
        try:
            return found.plant()
        except ValueError as error:
            relation = found.relation
            if relation.kind == "rows" or not relation.parameters:
                raise MachineError(f"No calibration: {error}") from error
            filter = LowPass(self.rates(log, given)["cutoff"].constant)
            return AlgebraicObserver(relation, filter)

    def leaf(self, model: Any, name: str) -> Any:
        whole: Any = model.relation if isinstance(model, AlgebraicObserver) else model
        return whole.parameters[name]

    def noise_groups(self):
        singly = lambda names: tuple((k,) for k in range(len(names)))
        return singly(self.signals.inputs), singly(self.signals.outputs)

    def noise_units(self) -> tuple[str, str]:
        return "", ""

    def columns_of_log(self):
        model, states = self.found().model, self.found().states
        names = [*model.inputs, *model.outputs, *states]
        units = [f"{n} {model.unit(n)}" for n in names if model.unit(n)]
        signals = Signals(
            tuple(model.inputs),
            tuple(model.outputs),
            truth=tuple(f"{name}_true" for name in states),
            note="; ".join(units),
        )
        quantities = (Quantity(name, (name,), model.unit(name)) for name in states)
        return Layout(signals, tuple(quantities))

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, float]) -> Rates:
        slowest = slowest_of(self.found(), self.observer.completion)
        if "cutoff" in stated:
            if stated["cutoff"] <= slowest:
                raise MachineError(
                    f"the cutoff must be above {slowest:.4g} rad/s, by the fastest mode of "
                    f"the model, but is {stated['cutoff']:.4g}; raise --cutoff or "
                    "`observer.cutoff`."
                )
            return {}
        if log is None:
            return {}
        cutoff, why = cutoff_for_positions(log.t, log.y)
        why = why.replace("positions", "outputs")
        if cutoff < FASTER * slowest:
            cutoff, why = FASTER * slowest, "above the fastest mode of the model"
        return {"cutoff": Rate(cutoff, why)}

    def condensed(self, log: Log) -> CondensedLog:
        return CondensedLog(log.t, np.zeros((log.t.size, 0)), log.y, {})

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings, gain = self.observer, rates.get("gain")
        if _lifted.is_lifted(settings):
            return _lifted.lifted_states(self.found(), settings)
        return state_observer(
            self.found(),
            rates["cutoff"].value,
            settings.completion,
            settings.threshold,
            settings.start,
            None if gain is None else gain.value,
        )

    def columns(self, estimate: Any, log: Log) -> Columns:
        states = self.found().states
        found = in_columns(states, estimate.value) | certified(estimate)
        found |= _lifted.deviations_of(states, estimate)
        return found | _lifted.parameters_of(self.parameter_names(), estimate)

    def truth(self, log: Log) -> Columns:
        return {name.removesuffix("_true"): column for name, column in log.truth.items()}

    def residuals(self, columns: Columns, log: Log) -> Columns:
        states, steps = self.found().states, np.diff(log.t)
        x = np.stack([columns[name] for name in states], axis=1)
        found = self.found()
        of = functools.partial(found.coordinates.rate, found.relation.values)
        rates = np.asarray(jax.jit(jax.vmap(of))(*map(jnp.asarray, (x, log.u, log.y))))
        left = {}
        for name, value, slope in zip(states, x.T, rates.T, strict=True):
            mean = 0.5 * (slope[1:] + slope[:-1]) * steps
            error = over_window(np.diff(value) - mean, WINDOW)
            size = over_window(np.abs(mean), WINDOW) + np.abs(value)
            left[name] = relative(error, size)
        return left
