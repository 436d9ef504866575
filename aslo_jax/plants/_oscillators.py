"""Oscillators of textbooks, without units but that of time."""

from typing import ClassVar

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Lorenz", "VanDerPol"]


class VanDerPol(AbstractVectorPlant):
    """Van der Pol's oscillator: `q'' = damping (1 - q^2) q' - q + u`. Input the force u,
    output the position q, hidden part the speed q'.

    - `damping`: how far it is from a linear one.

    Source: van der Pol 1926, doi:10.1080/14786442608564127.
    """

    damping: Scalar = parameter("negative at the middle", "1/s", 1.0)

    states: ClassVar = {"speed": Span(-3.0, 3.0, "1/s")}
    outputs: ClassVar = {"position": Span(-2.5, 2.5, "1")}
    inputs: ClassVar = {"force": Span(-1.0, 1.0, "1/s^2")}
    first: ClassVar = (0.0, 1.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [self.damping * (1.0 - y[0] ** 2) * x[0] - y[0] + u[0]]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del y, u
        return [x[0]]


class Lorenz(AbstractVectorPlant):
    """Lorenz' model of convection: `x1' = sigma (x2 - x1)`, `x2' = x1 (rho - x3) - x2`,
    `x3' = x1 x2 - beta x3`, chaotic with the default parameters. No input, output x1,
    hidden part `(x2, x3)`.

    - `sigma`, `rho`, `beta`: the Prandtl number, the relative Rayleigh number, and a number
      of the shape of the rolls.

    Source: Lorenz 1963, doi:10.1175/1520-0469(1963)020<0130:DNF>2.0.CO;2.
    """

    sigma: Scalar = parameter("Prandtl number", "1/s", 10.0)
    rho: Scalar = parameter("relative Rayleigh number", "1/s", 28.0)
    beta: Scalar = parameter("of the shape of the rolls", "1/s", 8.0 / 3.0)

    states: ClassVar = {"x2": Span(-25.0, 25.0), "x3": Span(0.0, 50.0)}
    outputs: ClassVar = {"x1": Span(-20.0, 20.0)}
    inputs: ClassVar = {}
    first: ClassVar = (-3.0, 22.0, 1.4)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [y[0] * (self.rho - x[1]) - x[0], y[0] * x[0] - self.beta * x[1]]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [self.sigma * (x[0] - y[0])]
