"""The motor with brushes and permanent magnets, by what is measured of it."""

from typing import ClassVar

import equinox as eqx

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["DCMotor", "DCMotorWithTachometer"]

CURRENT = Span(-10.0, 10.0, "A")
SPEED = Span(-400.0, 400.0, "rad/s")
VOLTAGE = {"voltage": Span(-24.0, 24.0, "V")}


class AbstractDCMotor(AbstractVectorPlant):
    """`L i' = u - R i - K w`, `J w' = K i - b w - load`."""

    resistance: eqx.AbstractVar[Scalar]
    inductance: eqx.AbstractVar[Scalar]
    constant: eqx.AbstractVar[Scalar]
    inertia: eqx.AbstractVar[Scalar]
    friction: eqx.AbstractVar[Scalar]
    load: eqx.AbstractVar[Scalar]

    inputs: ClassVar = VOLTAGE
    unknown: ClassVar = ("load",)

    def current_rate(self, i: RealArray, w: RealArray, u: RealArray) -> RealArray:
        return (u[0] - self.resistance * i - self.constant * w) / self.inductance

    def speed_rate(self, i: RealArray, w: RealArray) -> RealArray:
        return (self.constant * i - self.friction * w - self.load) / self.inertia


class DCMotor(AbstractDCMotor):
    """A DC motor without a speed sensor: `L i' = u - R i - K w`,
    `J w' = K i - b w - load`, of the current i (A) and the speed w (rad/s). Input the
    voltage u (V), output the current, hidden part `(w, load)`: the load is not known.

    - `resistance` R (ohm), `inductance` L (H), `constant` K (N m/A, V s/rad) of torque and
      back-EMF, `inertia` J (kg m^2), `friction` b (N m s/rad), `load` (N m).

    By default round numbers of a motor of 24 V and 100 W with what it drives, of no one in
    particular.

    Source: Krishnan, "Electric Motor Drives", 2001, ch. 2, eqs. of the separately excited
    machine.
    """

    resistance: Scalar = parameter("of the armature", "ohm", 0.6)
    inductance: Scalar = parameter("of the armature", "H", 0.6e-3)
    constant: Scalar = parameter("of torque and back-EMF", "N m/A", 0.05)
    inertia: Scalar = parameter("of rotor and load", "kg m^2", 1e-4)
    friction: Scalar = parameter("viscous", "N m s/rad", 1e-5, sign="0")
    load: Scalar = parameter("torque of the load", "N m", 0.1, sign="")

    states: ClassVar = {"speed": SPEED}
    outputs: ClassVar = {"current": CURRENT}
    first: ClassVar = (0.0, 0.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [self.speed_rate(y[0], x[0])]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [self.current_rate(y[0], x[0], u)]


class DCMotorWithTachometer(AbstractDCMotor):
    """A DC motor without a current sensor: `L i' = u - R i - K w`,
    `J w' = K i - b w - load`, of the current i (A) and the speed w (rad/s). Input the
    voltage u (V), output the speed, hidden part `(i, load)`: the load is not known.

    - `resistance` R (ohm), `inductance` L (H), `constant` K (N m/A, V s/rad) of torque and
      back-EMF, `inertia` J (kg m^2), `friction` b (N m s/rad), `load` (N m).

    By default round numbers of a motor of 24 V and 100 W with what it drives, of no one in
    particular.

    Source: Krishnan, "Electric Motor Drives", 2001, ch. 2, eqs. of the separately excited
    machine.
    """

    resistance: Scalar = parameter("of the armature", "ohm", 0.6)
    inductance: Scalar = parameter("of the armature", "H", 0.6e-3)
    constant: Scalar = parameter("of torque and back-EMF", "N m/A", 0.05)
    inertia: Scalar = parameter("of rotor and load", "kg m^2", 1e-4)
    friction: Scalar = parameter("viscous", "N m s/rad", 1e-5, sign="0")
    load: Scalar = parameter("torque of the load", "N m", 0.1, sign="")

    states: ClassVar = {"current": CURRENT}
    outputs: ClassVar = {"speed": SPEED}
    first: ClassVar = (0.0, 0.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [self.current_rate(x[0], y[0], u)]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [self.speed_rate(x[0], y[0])]
