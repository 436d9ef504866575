"""The lateral motion of a car."""

from typing import ClassVar

import jax.numpy as jnp

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["LateralVehicle"]


class LateralVehicle(AbstractVectorPlant):
    """The single-track model of a car: `m (v' + V r) = Ff + Fr`, `I r' = a Ff - b Fr`,
    `Ff = Cf (delta - (v + a r)/V)`, `Fr = -Cr (v - b r)/V`, of the lateral speed v (m/s),
    the yaw rate r (rad/s), the speed V (m/s) and the steering angle delta (rad), which
    follows the wheel with a lag. Input the acceleration along the car (m/s^2) and the
    demanded steering angle (rad), output the yaw rate, the lateral acceleration
    `(Ff + Fr)/m + bias`, the speed and the steering angle, hidden part `(v, bias)`: the
    bias of the accelerometer is not known.

    - `mass` m (kg); `inertia` I (kg m^2) of yaw; `front` a, `rear` b (m), the distances of
      the axles from the centre of mass; `front_stiffness` Cf, `rear_stiffness` Cr (N/rad)
      of each axle; `bias` (m/s^2); `steering_lag` (s).

    By default the car of the source, whose stiffness is that of a tyre, half of an axle's.

    Source: Rajamani, "Vehicle Dynamics and Control", 2012, ch. 2 and 3,
    doi:10.1007/978-1-4614-1433-9.
    """

    mass: Scalar = parameter("of the car", "kg", 1573.0)
    inertia: Scalar = parameter("of yaw", "kg m^2", 2873.0)
    front: Scalar = parameter("front axle from the centre of mass", "m", 1.1)
    rear: Scalar = parameter("rear axle from the centre of mass", "m", 1.58)
    front_stiffness: Scalar = parameter("of the front axle", "N/rad", 160e3)
    rear_stiffness: Scalar = parameter("of the rear axle", "N/rad", 160e3)
    bias: Scalar = parameter("of the accelerometer", "m/s^2", 0.3, sign="")
    steering_lag: Scalar = parameter("of the steering", "s", 0.1)

    states: ClassVar = {"lateral_speed": Span(-2.0, 2.0, "m/s")}
    outputs: ClassVar = {
        "yaw_rate": Span(-0.5, 0.5, "rad/s"),
        "lateral_acceleration": Span(-6.0, 6.0, "m/s^2"),
        "speed": Span(10.0, 35.0, "m/s"),
        "steering": Span(-0.1, 0.1, "rad"),
    }
    inputs: ClassVar = {
        "acceleration": Span(-3.0, 3.0, "m/s^2"),
        "steering_demand": Span(-0.1, 0.1, "rad"),
    }
    others: ClassVar = {
        "yaw_rate": Span(-0.5, 0.5, "rad/s"),
        "speed": Span(10.0, 35.0, "m/s"),
        "steering": Span(-0.1, 0.1, "rad"),
    }
    unknown: ClassVar = ("bias",)
    first: ClassVar = (0.0, 0.0, 20.0, 0.0)

    def forces(
        self, v: RealArray, r: RealArray, speed: RealArray, steering: RealArray
    ) -> tuple[RealArray, RealArray]:
        """The lateral forces (N) on the axles."""
        front = steering - (v + self.front * r) / speed
        rear = -(v - self.rear * r) / speed
        return self.front_stiffness * front, self.rear_stiffness * rear

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [y[1] - self.bias - y[2] * y[0]]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray | None]:
        del u
        front, rear = self.forces(x[0], y[0], y[2], y[3])
        return [(self.front * front - self.rear * rear) / self.inertia, None, None, None]

    def h(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        front, rear = self.forces(x[0], y[0], y[2], y[3])
        return [(front + rear) / self.mass + self.bias - y[1]]

    def measured(self, x: RealArray, w: RealArray) -> RealArray:
        front, rear = self.forces(x[0], *w)
        return jnp.stack([w[0], (front + rear) / self.mass + self.bias, w[1], w[2]])

    def other_rates(self, x: RealArray, w: RealArray, u: RealArray) -> list[RealArray]:
        front, rear = self.forces(x[0], *w)
        yaw = (self.front * front - self.rear * rear) / self.inertia
        return [yaw, u[0], (u[1] - w[2]) / self.steering_lag]
