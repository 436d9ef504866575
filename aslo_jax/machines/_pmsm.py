"""`kind = "pmsm"`: the surface-mounted permanent-magnet synchronous motor."""

from typing import Any, ClassVar, Literal

from ..diagnosis import Circle
from ..plants import PMSM, FluxRelation
from ..schema import Positive, Table, Whole, key
from . import motor, offers
from ._base import Unknowns
from ._study import Study


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
    )

    def plant(self) -> Any:
        return PMSM(**self.machine.model_dump(exclude={"kind"}))

    def circles(self) -> tuple[Circle, ...]:
        machine = self.machine
        return (
            Circle("flux", machine.resistance, machine.inductance, machine.magnet_flux),
        )
