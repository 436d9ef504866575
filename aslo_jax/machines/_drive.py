"""`kind = "drive"`: a drive of one degree of freedom."""

from typing import Any, ClassVar, Literal

from pydantic import field_validator

from ..plants import Drive
from ..schema import NonNegative, Table, key
from ._base import Layout, Unknowns
from ._mechanism import AbstractMechanism, layout


class DriveTable(Table):
    """`[machine]` of a drive of one degree of freedom: `q'' = -decay q' + gain u`."""

    kind: Literal["drive"] = key("the kind of machine", example="drive")
    decay: NonNegative = key("friction and back-EMF over inertia", "1/s", example=400.0)
    gain: float = key(
        "acceleration for one of the input, not zero",
        "rad/s^2 per unit of u1",
        example=20e3,
        allowed="a finite number other than zero",
    )

    @field_validator("gain")
    @classmethod
    def _driven(cls, gain: float) -> float:
        if gain == 0.0:
            raise ValueError("`machine.gain` must be a finite number other than zero")
        return gain


class DriveDescription(AbstractMechanism[DriveTable]):
    """A drive of one degree of freedom: its speed from its angle and what drives it."""

    machine: DriveTable

    kind = "drive"
    title: ClassVar[str] = "Drive"
    layout: ClassVar[Layout] = layout((True,), 1, "u1 a voltage (V), say; q1 of the shaft")
    unknowns: ClassVar[Unknowns] = Unknowns(("decay", "gain"))

    def plant(self) -> Any:
        return Drive(**self.machine.model_dump(exclude={"kind"}))
