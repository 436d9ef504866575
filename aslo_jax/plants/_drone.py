"""A multirotor that climbs and descends."""

from typing import ClassVar

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Drone"]


class Drone(AbstractVectorPlant):
    """The vertical motion of a multirotor: `m v' = u - m gravity - d (v - wind)`, of the
    speed v (m/s) upwards, with the drag of its rotors, which is linear in the speed against
    the air. Input the thrust u (N), output the height (m), hidden part `(v, wind)`: the
    updraught is not known.

    - `mass` m (kg); `drag` d (N s/m); `gravity` (m/s^2); `wind` (m/s), upwards.

    By default round numbers of a quadrotor of 1 kg, of no one in particular.

    Source: Faessler, Franchi, Scaramuzza 2018, doi:10.1109/LRA.2017.2776353, for drag that
    is linear in the speed.
    """

    mass: Scalar = parameter("of the drone", "kg", 1.0)
    drag: Scalar = parameter("of the rotors", "N s/m", 0.5)
    gravity: Scalar = parameter("gravity", "m/s^2", 9.81)
    wind: Scalar = parameter("the updraught", "m/s", 1.0, sign="")

    states: ClassVar = {"speed": Span(-5.0, 5.0, "m/s")}
    outputs: ClassVar = {"height": Span(0.0, 30.0, "m")}
    inputs: ClassVar = {"thrust": Span(5.0, 15.0, "N")}
    unknown: ClassVar = ("wind",)
    first: ClassVar = (0.0, 10.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del y
        return [(u[0] - self.drag * (x[0] - self.wind)) / self.mass - self.gravity]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del y, u
        return [x[0]]
