"""`kind = "pmsm"`: the surface-mounted permanent-magnet synchronous motor."""

from typing import Any, ClassVar, Literal

from ..diagnosis import Circle
from ..plants import PMSM, FluxRelation
from ..schema import Positive, Table, Whole, key
from . import motor, offers
from ._base import Unknowns
from ._study import Errors, Explored, Range, Study


class PMSMTable(Table):
    """`[machine]` of a PMSM, in SI units."""

    kind: Literal["pmsm"] = key("the kind of machine", example="pmsm")
    resistance: Positive = key("stator resistance", "ohm", example=8.875)
    inductance: Positive = key("stator inductance", "H", example=40.03e-3)
    magnet_flux: Positive = key("magnet flux, amplitude", "Wb", example=0.2086)
    pole_pairs: Whole = key("number of pole pairs", example=5)
    inertia: Positive = key("inertia of the rotor", "kg m^2", example=60e-6)


def _relations(plant: PMSM) -> tuple[FluxRelation]:
    return (plant.flux_relation(),)


class PMSMDescription(motor.AbstractRoundMotor[PMSMTable]):
    """A surface-mounted PMSM: flux, angle and speed from stator voltages and currents."""

    machine: PMSMTable

    kind = "pmsm"
    title: ClassVar[str] = "Surface-mounted PMSM"
    residual: ClassVar[str] = "| |flux - L i| / magnet flux - 1 |"
    unknowns: ClassVar[Unknowns] = Unknowns(("resistance", "inductance", "magnet_flux"))
    study: ClassVar[Study | None] = Study(
        machine=PMSMTable,
        acting=motor.RotorTable,
        entries=("flux_alpha", "flux_beta"),
        units=("Wb", "Wb"),
        plant=lambda table: motor.with_load(PMSM, table),
        observers=offers.algebraic(_relations)
        | offers.integrator(_relations)
        | offers.lifted(_relations)
        | offers.adaptive(_relations)
        | offers.mixing(_relations)
        | offers.of_round_motor(),
        controls=("field_oriented",),
        metrics=("angle", "peak_angle"),
        bound=True,
        explored=Explored(
            run=(
                Range("control.reference.offset", "speed, mean", "rad/s", -80.0, 80.0),
                Range("control.reference.amplitude", "speed, swing", "rad/s", 0.0, 40.0),
                Range("control.reference.frequency", "its frequency", "rad/s", 0.0, 40.0),
                Range("machine.load.offset", "load torque", "N m", -2.0, 2.0),
            ),
            start=(
                Range("machine.initial.speed", "speed", "rad/s", -80.0, 80.0),
                Range("machine.initial.angle", "rotor angle", "rad", -0.6, 0.6),
            ),
            outputs=Errors("A", noise=0.3, offset=0.3),
            inputs=Errors("V", noise=3.0, offset=3.0),
            dead_time=10.0,
            initial={"speed": 0.0, "angle": 0.0},
            # At standstill nothing shows its flux, and the load would stall it first.
            usual={"machine.initial.speed": 20.0, "machine.load.offset": 0.0},
            magnet=True,
        ),
    )

    def plant(self) -> Any:
        return PMSM(**self.machine.model_dump(exclude={"kind"}))

    def circles(self) -> tuple[Circle, ...]:
        machine = self.machine
        return (
            Circle("flux", machine.resistance, machine.inductance, machine.magnet_flux),
        )
