"""`kind = "stepper"`: the two-phase permanent-magnet stepper motor."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from ..logs import Log
from ..observers import AbstractObserver
from ..plants import Stepper
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


class StepperTable(Table):
    """`[machine]` of a stepper, in SI units."""

    kind: Literal["stepper"] = key("the kind of machine", example="stepper")
    resistance: Positive = key("resistance of a phase", "ohm", example=0.55)
    inductance: Positive = key("inductance of a phase", "H", example=1.5e-3)
    torque_constant: Positive = key(
        "largest torque of one phase per ampere", "N m/A", example=0.19
    )
    pole_pairs: Whole = key(
        "teeth of the rotor, a quarter of the full steps per turn", example=50
    )
    inertia: Positive = key("inertia of the rotor", "kg m^2", example=4.5e-5)


class StepperDescription(AbstractDescription[StepperTable, motor.MotorObserver]):
    """A two-phase stepper: fluxes, angle and speed from phase voltages and currents."""

    machine: StepperTable
    observer: motor.MotorObserver = motor.MotorObserver()

    kind = "stepper"
    title = "Two-phase stepper"
    layout = motor.LAYOUT
    motion = "does the motor turn?"
    residual = "| |flux - L i| / (torque constant / pole pairs) - 1 |"
    refused: ClassVar = {}
    longest_interval = motor.LONGEST_INTERVAL

    def plant(self) -> Stepper:
        return Stepper(**self.machine.model_dump(exclude={"kind"}))

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
        return {"flux": np.abs(size / float(self.plant().magnet_flux) - 1.0)}
