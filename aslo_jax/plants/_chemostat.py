"""A continuous culture of microorganisms."""

from typing import ClassVar

from jaxtyping import Array, Float

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Chemostat"]


class Chemostat(AbstractVectorPlant):
    """A chemostat with Monod's growth: `b' = (mu - D) b`, `s' = D (feed - s) - k mu b`,
    `mu = mu_max s/(K + s)`, of the biomass b and the substrate s (kg/m^3, grams in a
    litre). Input the dilution rate D (1/s), output the substrate, hidden part the biomass.

    - `growth` mu_max (1/s); `saturation` K (kg/m^3), where the growth is half of that;
      `consumption` k (kg of substrate for one of biomass); `feed` (kg/m^3), the substrate
      in the inflow.

    By default round numbers of bacteria on glucose, 0.4 1/h, of no one in particular.

    Source: Bastin, Dochain, "On-line Estimation and Adaptive Control of Bioreactors", 1990,
    ch. 1; Monod 1949, doi:10.1146/annurev.mi.03.100149.002103.
    """

    growth: Scalar = parameter("the largest growth rate", "1/s", 0.4 / 3600.0)
    saturation: Scalar = parameter("substrate at half of it", "kg/m^3", 0.5)
    consumption: Scalar = parameter("substrate for a unit of biomass", "1", 2.0)
    feed: Scalar = parameter("substrate in the inflow", "kg/m^3", 10.0)

    states: ClassVar = {"biomass": Span(0.5, 6.0, "kg/m^3")}
    outputs: ClassVar = {"substrate": Span(0.1, 8.0, "kg/m^3")}
    inputs: ClassVar = {"dilution": Span(0.0, 1e-4, "1/s")}
    first: ClassVar = (2.0, 3.0)

    def rate_of_growth(self, substrate: Float[Array, ""]) -> Float[Array, ""]:
        """Monod's mu (1/s) at a concentration of `substrate` (kg/m^3)."""
        return self.growth * substrate / (self.saturation + substrate)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [(self.rate_of_growth(y[0]) - u[0]) * x[0]]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        eaten = self.consumption * self.rate_of_growth(y[0]) * x[0]
        return [u[0] * (self.feed - y[0]) - eaten]
