"""A pole on a cart."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["CartPole"]


class CartPole(AbstractVectorPlant):
    """A pole on a cart, with friction: `(M + m) s'' + m l (cos a a'' - sin a a'^2) =
    u - b s'`, `4/3 m l^2 a'' + m l cos a s'' = m gravity l sin a - c a'`, of the position s
    (m) of the cart and the angle a (rad) of the pole from the upright. Input the force u
    (N) on the cart, output position and angle (unwrapped), hidden part `(p, a')`, with the
    momentum along the rail `p = (M + m) s' + m l cos a a'` (kg m/s), in which there is no
    product of speeds; [`CartPole.cart_speed`][] gives `s'`.

    - `cart_mass` M, `pole_mass` m (kg); `half_length` l (m) of the pole; `gravity`
      (m/s^2); `cart_friction` b (N s/m), `pole_friction` c (N m s/rad).

    By default cart and pole of the source, with viscous friction in the place of its dry
    one of the cart, and a thousand times its friction of the pole.

    Source: Barto, Sutton, Anderson 1983, doi:10.1109/TSMC.1983.6313077.
    """

    cart_mass: Scalar = parameter("of the cart", "kg", 1.0)
    pole_mass: Scalar = parameter("of the pole", "kg", 0.1)
    half_length: Scalar = parameter("of the pole", "m", 0.5)
    gravity: Scalar = parameter("gravity", "m/s^2", 9.81)
    cart_friction: Scalar = parameter("of the cart", "N s/m", 0.1, sign="0")
    pole_friction: Scalar = parameter("of the pole", "N m s/rad", 2e-3, sign="0")

    states: ClassVar = {
        "momentum": Span(-2.0, 2.0, "kg m/s"),
        "pole_speed": Span(-6.0, 6.0, "rad/s"),
    }
    outputs: ClassVar = {
        "position": Span(-2.4, 2.4, "m"),
        "angle": Span(-4.0, 4.0, "rad"),
    }
    inputs: ClassVar = {"force": Span(-10.0, 10.0, "N")}
    first: ClassVar = (0.0, 0.0, 0.0, 2.8)

    def cart_speed(self, x: Float[Array, " 2"], y: Float[Array, " 2"]) -> Float[Array, ""]:
        """The speed of the cart (m/s), from the hidden part x and the output y."""
        moment = self.pole_mass * self.half_length * jnp.cos(y[1])
        return (x[0] - moment * x[1]) / (self.cart_mass + self.pole_mass)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        c, s = jnp.cos(y[1]), jnp.sin(y[1])
        push = u[0] - self.cart_friction * self.cart_speed(x, y)
        moment = self.pole_mass * self.half_length
        whole, along = self.cart_mass + self.pole_mass, moment * c
        cart = push + moment * s * x[1] ** 2
        pole = moment * self.gravity * s - self.pole_friction * x[1]
        inertia = 4.0 / 3.0 * moment * self.half_length * whole - along * along
        return [push, (whole * pole - along * cart) / inertia]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [self.cart_speed(x, y), x[1]]
