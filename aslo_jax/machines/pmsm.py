"""`kind = "pmsm"`: the surface-mounted permanent-magnet synchronous motor."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from ..logs import Log
from ..observers import AbstractObserver
from ..plants import PMSM
from . import motor
from .base import (
    AbstractDescription,
    Columns,
    Positive,
    Rate,
    Rates,
    Table,
    Whole,
    algebraic,
    key,
)


class PMSMTable(Table):
    """`[machine]` of a PMSM, in SI units."""

    kind: Literal["pmsm"] = key("the kind of machine", example="pmsm")
    resistance: Positive = key("stator resistance", "ohm", example=8.875)
    inductance: Positive = key("stator inductance", "H", example=40.03e-3)
    magnet_flux: Positive = key("magnet flux, amplitude", "Wb", example=0.2086)
    pole_pairs: Whole = key("number of pole pairs", example=5)
    inertia: Positive = key("inertia of the rotor", "kg m^2", example=60e-6)


class PMSMDescription(AbstractDescription[PMSMTable, motor.MotorObserver]):
    """A surface-mounted PMSM: flux, angle and speed from stator voltages and currents."""

    machine: PMSMTable
    observer: motor.MotorObserver = motor.MotorObserver()

    kind = "pmsm"
    title = "Surface-mounted PMSM"
    layout = motor.LAYOUT
    motion = "does the motor turn?"
    residual = "| |flux - L i| / magnet flux - 1 |"
    refused: ClassVar = {}
    longest_interval = motor.LONGEST_INTERVAL

    def plant(self) -> PMSM:
        return PMSM(**self.machine.model_dump(exclude={"kind"}))

    def default_rates(self, log: Log | None, stated: Mapping[str, float]) -> Rates:
        return motor.motor_rates(log, stated)

    def condensed(self, log: Log) -> Log:
        return motor.driving(log, self.machine.resistance)

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings = self.observer
        return algebraic(
            self.plant().flux_relation(),
            rates["cutoff"].value,
            threshold=settings.threshold,
            completion=settings.completion,
            start=settings.start,
            gain=rates.get("gain"),
        )

    def columns(self, estimate: Any, log: Log) -> Columns:
        magnet = np.asarray(estimate.value) - self.machine.inductance * log.y
        return motor.motor_columns(estimate, magnet)

    def truth(self, log: Log) -> Columns:
        return motor.motor_truth(log, self.machine.pole_pairs)

    def residuals(self, columns: Columns, log: Log) -> Columns:
        magnet = motor.flux_of(columns) - self.machine.inductance * log.y
        size = np.linalg.norm(magnet, axis=1)
        return {"flux": np.abs(size / self.machine.magnet_flux - 1.0)}
