"""`kind = "robotic_leg"`: the extensible leg."""

from typing import Any, ClassVar, Literal

from ..plants import RoboticLeg
from ..schema import Positive, Table, key
from ._base import Layout, Unknowns
from ._mechanism import AbstractMechanism, Three, layout, study
from ._study import Errors, Explored, Range, Study


class RoboticLegTable(Table):
    """`[machine]` of an extensible leg, in SI units."""

    kind: Literal["robotic_leg"] = key("the kind of machine", example="robotic_leg")
    m1: Positive = key("mass at the end of the leg", "kg", example=2.0)
    m2: Positive = key("inertia of the body", "kg m^2", example=3.0)
    damping: Three = key(
        "friction of length, leg and body",
        "N s/m, N m s/rad",
        default=[0.0, 0.0, 0.0],
        allowed="three finite numbers that are not negative",
    )


class RoboticLegDescription(AbstractMechanism[RoboticLegTable]):
    """An extensible leg on a body: velocities from length and angles, force and torque."""

    machine: RoboticLegTable

    kind = "robotic_leg"
    title: ClassVar[str] = "Extensible leg"
    layout: ClassVar[Layout] = layout(
        (False, True, True),
        2,
        "q1 length, q2 angle of the leg, q3 of the body; u1 along the leg, u2 between leg "
        "and body",
    )
    unknowns: ClassVar[Unknowns] = Unknowns(("m1", "m2", "damping"))
    study: ClassVar[Study | None] = study(
        RoboticLegTable,
        RoboticLeg,
        {"length": "m/s", "leg": "rad/s", "body": "rad/s"},
        "tracking",
        bound=True,
        explored=Explored(
            run=(
                Range("control.reference.amplitude.0", "length, swing", "m", 0.0, 0.5),
                Range("control.reference.amplitude.1", "angle, swing", "rad", 0.0, 1.5),
                Range("control.bandwidth", "of the tracking", "rad/s", 0.5, 20.0),
            ),
            start=(
                Range("machine.initial.position.0", "length", "m", 0.3, 2.0),
                Range("machine.initial.position.1", "angle of the leg", "rad", -1.5, 1.5),
                Range("machine.initial.velocity.1", "its rate", "rad/s", -3.0, 3.0),
            ),
            outputs=Errors("m, rad", noise=1e-2, offset=0.05),
            inputs=Errors("N, N m", noise=5.0, offset=5.0),
        ),
    )

    def plant(self) -> Any:
        return RoboticLeg(**self.machine.model_dump(exclude={"kind"}))
