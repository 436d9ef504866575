"""`kind = "stepper"`: the two-phase permanent-magnet stepper motor."""

from typing import Any, ClassVar, Literal

from ..diagnosis import Circle
from ..plants import Stepper
from ..schema import Positive, Table, Whole, key
from . import motor
from ._base import Unknowns


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


class StepperDescription(motor.AbstractRoundMotor[StepperTable]):
    """A two-phase stepper: fluxes, angle and speed from phase voltages and currents."""

    machine: StepperTable

    kind = "stepper"
    title: ClassVar[str] = "Two-phase stepper"
    residual: ClassVar[str] = "| |flux - L i| / (torque constant / pole pairs) - 1 |"
    unknowns: ClassVar[Unknowns] = Unknowns(("resistance", "inductance", "torque_constant"))

    def plant(self) -> Any:
        return Stepper(**self.machine.model_dump(exclude={"kind"}))

    def circles(self) -> tuple[Circle, ...]:
        machine = self.machine
        circle = Circle(
            "flux",
            machine.resistance,
            machine.inductance,
            machine.torque_constant / machine.pole_pairs,
            radius_name="magnet flux, torque constant / pole pairs,",
            phases=2,
        )
        return (circle,)
