"""`kind = "derived"`: any system, written in Python as a model."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from .._completions import LeastSquares, Repeat
from .._derive.plant import ModelPlant
from .._filters import LowPass
from .._guard import Guard
from ..derivation import Derived, Model, derive, model_of
from ..logs import Log, Signals
from ..observers import AbstractObserver
from ..plants import AbstractModelledPlant
from ..schema import Positive, Table, key
from . import _keys as keys
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
from ._frequency import cutoff_for_positions
from ._python import load

THRESHOLD = 1e-6  # relation's x may have many entries: a relative error of 0.1 %
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


def load_model(path: str, folder: Path) -> Model:
    """The model of an import `path`, `"module:attribute"`, whose module may lie in
    `folder`; of a plant that is one, that.

    **Raises:** [`MachineError`][].
    """
    what, wanted = f"`machine.model`, {path}:", (Model, AbstractModelledPlant)
    found = load(path, folder, what, wanted, "an `aslo_jax.Model`, or a plant that is one")
    return found if isinstance(found, Model) else model_of(found)


class DerivedTable(Table):
    """`[machine]` of a system of one's own."""

    kind: Literal["derived"] = key("the kind of machine", example="derived")
    model: Annotated[str, Field(pattern=r"^\w+(\.\w+)*:\w+(\.\w+)*$")] = key(
        "an `aslo.Model`, a plant that is one, or what returns one; Python that is run",
        example="motor:model",
        allowed='"module:attribute", with dots where there are packages',
    )


class DerivedObserverTable(Table):
    """`[observer]` of a derived relation, all optional."""

    cutoff: Positive | None = keys.cutoff(example=30.0)
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold(THRESHOLD)


class DerivedDescription(AbstractDescription[DerivedTable, DerivedObserverTable]):
    """A system of one's own, whose observer is derived from its model. Reading its
    description runs the module that `model` names, which may lie beside the TOML file.

    **Raises:** `ValueError` where the module cannot be run, gives no model, or one from
    which no relation can be derived.
    """

    machine: DerivedTable
    observer: DerivedObserverTable = DerivedObserverTable()
    _found: Any = PrivateAttr(default=None)

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
    unknowns: ClassVar[Unknowns] = Unknowns(
        refused="its parameters are in Python; name them in `unknown` of the model, or use "
        "`aslo_jax.tune.calibrate` there"
    )

    @model_validator(mode="after")
    def _load(self, info):
        folder = (info.context or {}).get("folder", Path())
        path = self.machine.model
        what = f"`machine.model`, {path}:"
        model = load_model(path, folder)
        try:
            self._found = derive(model)
        except ValueError as error:
            raise ValueError(f"{what} {error}") from error
        if not self._found.states:
            raise ValueError(
                f"{what} the relation tells of {', '.join(self._found.lifted)}, from which "
                "no state alone can be taken"
            )
        return self

    def found(self) -> Derived:
        """What was derived."""
        return self._found

    def plant(self) -> Any:
        return ModelPlant(self._found.model)

    def columns_of_log(self):
        model, states = self._found.model, self._found.states
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
        slowest = self._found.slowest
        if self.observer.completion == "repeat":
            slowest = 0.5 * slowest
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
        averaged = settings.completion == "least-squares"
        return self._found.observer(
            LowPass(rates["cutoff"].value),
            completion=LeastSquares() if averaged else Repeat(),
            guard=Guard(threshold=settings.threshold),
            start=settings.start,
            gain=None if gain is None else gain.value,
        )

    def columns(self, estimate: Any, log: Log) -> Columns:
        return in_columns(self._found.states, estimate.value) | certified(estimate)

    def truth(self, log: Log) -> Columns:
        return {name.removesuffix("_true"): column for name, column in log.truth.items()}

    def residuals(self, columns: Columns, log: Log) -> Columns:
        states, steps = self._found.states, np.diff(log.t)
        x = np.stack([columns[name] for name in states], axis=1)
        rate = jax.jit(jax.vmap(self._found.coordinates.rate))
        rates = np.asarray(rate(*map(jnp.asarray, (x, log.u, log.y))))
        found = {}
        for name, value, slope in zip(states, x.T, rates.T, strict=True):
            mean = 0.5 * (slope[1:] + slope[:-1]) * steps
            error = over_window(np.diff(value) - mean, WINDOW)
            size = over_window(np.abs(mean), WINDOW) + np.abs(value)
            found[name] = relative(error, size)
        return found
