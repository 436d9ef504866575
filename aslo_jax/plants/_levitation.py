"""A body below one coil."""

from typing import ClassVar

import jax.numpy as jnp

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Levitation"]


class Levitation(AbstractVectorPlant):
    """A body of iron held below one coil: `psi' = u - R i`, `i = q psi/k`,
    `m q'' = m gravity - psi^2/(2 k)`, of the flux psi (Wb) that the coil links and the
    distance q (m) of the body from it, downwards. Input the voltage u (V), output the
    distance and the current i (A), hidden part `(psi, q')`. Unstable without a controller.

    - `resistance` R (ohm); `force_constant` k (H m), inductance times distance; `mass` m
      (kg); `gravity` (m/s^2).

    By default round numbers of a ball of 60 g, 10 mm below a coil with 1 A, of no one in
    particular.

    Source: Ortega, Loria, Nicklasson, Sira-Ramirez, "Passivity-based Control of
    Euler-Lagrange Systems", 1998, ch. 8, doi:10.1007/978-1-4471-3603-3.
    """

    resistance: Scalar = parameter("of the coil", "ohm", 5.0)
    force_constant: Scalar = parameter("k = L q", "H m", 1.2e-4)
    mass: Scalar = parameter("of the body", "kg", 0.06)
    gravity: Scalar = parameter("gravity", "m/s^2", 9.81)

    states: ClassVar = {"flux": Span(0.0, 0.03, "Wb"), "speed": Span(-0.3, 0.3, "m/s")}
    outputs: ClassVar = {
        "distance": Span(4e-3, 16e-3, "m"),
        "current": Span(0.2, 2.0, "A"),
    }
    inputs: ClassVar = {"voltage": Span(-20.0, 20.0, "V")}
    others: ClassVar = {"distance": Span(4e-3, 16e-3, "m")}
    # 10 mm of distance; the flux that carries 60 g
    first: ClassVar = (0.011885453, 0.0, 0.01)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        pull = x[0] ** 2 / (2.0 * self.force_constant * self.mass)
        return [u[0] - self.resistance * y[1], self.gravity - pull]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray | None]:
        del y, u
        return [x[1], None]

    def h(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [y[0] * x[0] / self.force_constant - y[1]]

    def measured(self, x: RealArray, w: RealArray) -> RealArray:
        return jnp.stack([w[0], w[0] * x[0] / self.force_constant])

    def other_rates(self, x: RealArray, w: RealArray, u: RealArray) -> list[RealArray]:
        del w, u
        return [x[1]]
