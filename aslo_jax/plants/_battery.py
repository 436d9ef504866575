"""A cell of a battery."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Battery"]


class Battery(AbstractVectorPlant):
    """A cell with an exponential part of its open-circuit voltage and one RC pair:
    `z' = -i/Q`, `v1' = -v1/tau + i/C`,
    `v = base + slope z - depth exp(-z/knee) - v1 - R i`, of the state of charge z (0 to 1),
    the voltage v1 (V) of the pair and the current i (A), positive as it discharges, which
    follows what is demanded of it with a lag. Input the demanded current, output the
    terminal voltage v and the current, hidden part `(z, v1)`.

    - `capacity` Q (C); `time_constant` tau (s) and `capacitance` C (F) of the pair;
      `resistance` R (ohm) in series; `base` (V), `slope` (V), `depth` (V), `knee` of the
      open-circuit voltage; `current_lag` (s).

    By default the cell of 850 mA h of the source, with the straight line that is closest to
    its cubic polynomial for charges from 0 to 1, the constants of its impedance above a
    charge of 0.2, and of its RC pairs the fast one.

    Source: Chen, Rincon-Mora 2006, doi:10.1109/TEC.2006.874229.
    """

    capacity: Scalar = parameter("of the cell", "C", 3060.0)
    time_constant: Scalar = parameter("of the RC pair", "s", 32.85)
    capacitance: Scalar = parameter("of the RC pair", "F", 703.6)
    resistance: Scalar = parameter("in series", "ohm", 0.07446)
    base: Scalar = parameter("open-circuit voltage, its line at 0", "V", 3.6406)
    slope: Scalar = parameter("open-circuit voltage, of its line", "V", 0.3859)
    depth: Scalar = parameter("open-circuit voltage, its drop at 0", "V", 1.031)
    knee: Scalar = parameter("charge over which that fades", "1", 1.0 / 35.0)
    current_lag: Scalar = parameter("of the current", "s", 0.5)

    states: ClassVar = {"charge": Span(0.02, 1.0, "1"), "rc_voltage": Span(-0.1, 0.1, "V")}
    outputs: ClassVar = {"voltage": Span(2.8, 4.2, "V"), "current": Span(-1.7, 1.7, "A")}
    inputs: ClassVar = {"demand": Span(-1.7, 1.7, "A")}
    others: ClassVar = {"current": Span(-1.7, 1.7, "A")}
    first: ClassVar = (0.2, 0.0, 0.0)

    def open_circuit(self, charge: Float[Array, ""]) -> Float[Array, ""]:
        """The open-circuit voltage (V) at a state of `charge`."""
        line = self.base + self.slope * charge
        return line - self.depth * jnp.exp(-charge / self.knee)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        pair = y[1] / self.capacitance - x[1] / self.time_constant
        return [-y[1] / self.capacity, pair]

    def h(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [self.open_circuit(x[0]) - x[1] - self.resistance * y[1] - y[0]]

    def measured(self, x: RealArray, w: RealArray) -> RealArray:
        inner = self.open_circuit(x[0]) - x[1]
        return jnp.stack([inner - self.resistance * w[0], w[0]])

    def other_rates(self, x: RealArray, w: RealArray, u: RealArray) -> list[RealArray]:
        del x
        return [(u[0] - w[0]) / self.current_lag]
