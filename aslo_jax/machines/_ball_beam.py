"""`kind = "ball_beam"`: the ball on a beam."""

from typing import Any, ClassVar, Literal

from ..plants import BallBeam
from ..schema import Positive, Table, key
from ._base import Layout, Unknowns
from ._mechanism import AbstractMechanism, Two, layout, study
from ._study import Errors, Explored, Range, Study


class BallBeamTable(Table):
    """`[machine]` of a ball on a beam, in SI units; torque and friction are for a kilogram
    of the ball."""

    kind: Literal["ball_beam"] = key("the kind of machine", example="ball_beam")
    length: Positive = key("of the beam, its square the inertia", "m", example=1.2)
    gravity: Positive = key("gravity", "m/s^2", default=9.81)
    damping: Two = key(
        "friction of ball and beam over its mass",
        "1/s, m^2/s",
        default=[0.0, 0.0],
        allowed="two finite numbers that are not negative",
    )


class BallBeamDescription(AbstractMechanism[BallBeamTable]):
    """A ball on a beam: velocities from position, angle and torque."""

    machine: BallBeamTable

    kind = "ball_beam"
    title: ClassVar[str] = "Ball and beam"
    layout: ClassVar[Layout] = layout(
        (False, True), 1, "q1 ball, q2 beam; u1 torque over the ball's mass"
    )
    unknowns: ClassVar[Unknowns] = Unknowns(("length", "damping"), further=("gravity",))
    study: ClassVar[Study | None] = study(
        BallBeamTable,
        BallBeam,
        {"ball": "m/s", "beam": "rad/s"},
        "ball_beam_tracking",
        explored=Explored(
            run=(
                Range("control.reference.amplitude", "ball, swing", "m", 0.0, 0.5),
                Range("control.reference.frequency", "its frequency", "rad/s", 0.0, 2.0),
            ),
            start=(
                Range("machine.initial.position.0", "position of the ball", "m", -0.5, 0.5),
                Range("machine.initial.position.1", "angle of the beam", "rad", -0.6, 0.6),
                Range("machine.initial.velocity.1", "its rate", "rad/s", -2.0, 2.0),
            ),
            outputs=Errors("m, rad", noise=1e-2, offset=0.05),
            inputs=Errors("N m/kg", noise=1.0, offset=1.0),
        ),
    )

    def plant(self) -> Any:
        return BallBeam(**self.machine.model_dump(exclude={"kind"}))
