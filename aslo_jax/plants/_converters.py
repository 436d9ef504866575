"""Converters of direct current, averaged over the period of their switch."""

from typing import ClassVar

from .._typing import RealArray
from ._modelled import AbstractVectorPlant, Scalar, Span, parameter

__all__ = ["Boost", "Buck", "Cuk"]

DUTY = Span(0.1, 0.9)


class Buck(AbstractVectorPlant):
    """A buck converter: `L i' = d E - r i - v`, `C v' = i - G v`, of the current i of the
    inductor (A) and the output voltage v (V), averaged over the period of the switch. Input
    the duty cycle d, output v, hidden part `(i, G)`: the load is not known.

    - `inductance` L (H) with its `resistance` r (ohm); `capacitance` C (F); `source` E (V);
      `load` G (S), the conductance of the load.

    By default round numbers of a converter from 24 to 12 V with 50 W at most, of no one in
    particular.

    Source: Erickson, Maksimovic, "Fundamentals of Power Electronics", 2020, ch. 7,
    doi:10.1007/978-3-030-43881-4.
    """

    inductance: Scalar = parameter("of the inductor", "H", 100e-6)
    resistance: Scalar = parameter("of the inductor", "ohm", 0.05)
    capacitance: Scalar = parameter("of the output", "F", 220e-6)
    source: Scalar = parameter("voltage of the source", "V", 24.0)
    load: Scalar = parameter("conductance of the load", "S", 0.2, sign="0")

    states: ClassVar = {"current": Span(0.0, 5.0, "A")}
    outputs: ClassVar = {"voltage": Span(5.0, 20.0, "V")}
    inputs: ClassVar = {"duty": DUTY}
    unknown: ClassVar = ("load",)
    first: ClassVar = (2.4, 12.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [(u[0] * self.source - self.resistance * x[0] - y[0]) / self.inductance]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [(x[0] - self.load * y[0]) / self.capacitance]


class Boost(AbstractVectorPlant):
    """A boost converter: `L i' = E - r i - (1 - d) v`, `C v' = (1 - d) i - G v`, of the
    current i of the inductor (A) and the output voltage v (V), averaged over the period of
    the switch. Input the duty cycle d, output v, hidden part `(i, G)`: the load is not
    known.

    - `inductance` L (H) with its `resistance` r (ohm); `capacitance` C (F); `source` E (V);
      `load` G (S), the conductance of the load.

    By default round numbers of a converter from 12 to 24 V with 50 W at most, of no one in
    particular.

    Source: Erickson, Maksimovic, "Fundamentals of Power Electronics", 2020, ch. 7,
    doi:10.1007/978-3-030-43881-4.
    """

    inductance: Scalar = parameter("of the inductor", "H", 100e-6)
    resistance: Scalar = parameter("of the inductor", "ohm", 0.05)
    capacitance: Scalar = parameter("of the output", "F", 330e-6)
    source: Scalar = parameter("voltage of the source", "V", 12.0)
    load: Scalar = parameter("conductance of the load", "S", 0.05, sign="0")

    states: ClassVar = {"current": Span(0.0, 6.0, "A")}
    outputs: ClassVar = {"voltage": Span(12.0, 36.0, "V")}
    inputs: ClassVar = {"duty": DUTY}
    unknown: ClassVar = ("load",)
    first: ClassVar = (2.4, 24.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        drop = self.resistance * x[0] + (1.0 - u[0]) * y[0]
        return [(self.source - drop) / self.inductance]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        return [((1.0 - u[0]) * x[0] - self.load * y[0]) / self.capacitance]


class Cuk(AbstractVectorPlant):
    """A Cuk converter: `L1 i1' = E - r1 i1 - (1 - d) v1`, `C1 v1' = (1 - d) i1 - d i2`,
    `L2 i2' = d v1 - r2 i2 - v2`, `C2 v2' = i2 - G v2`, of the currents of its inductors
    (A), the voltage v1 of the capacitor between them and the output voltage v2 (V), which
    is inverted, averaged over the period of the switch. Input the duty cycle d, output v2,
    hidden part `(i1, v1, i2, G)`: the load is not known.

    - `input_inductance` L1, `output_inductance` L2 (H), with their `input_resistance` r1,
      `output_resistance` r2 (ohm); `transfer_capacitance` C1, `output_capacitance` C2 (F);
      `source` E (V); `load` G (S), the conductance of the load.

    By default round numbers of a converter from 12 to 12 V with 24 W at most, of no one in
    particular.

    Source: Middlebrook, Cuk 1976, "A general unified approach to modelling
    switching-converter power stages", doi:10.1109/PESC.1976.7072895.
    """

    input_inductance: Scalar = parameter("L1, at the source", "H", 300e-6)
    output_inductance: Scalar = parameter("L2, at the load", "H", 200e-6)
    input_resistance: Scalar = parameter("of the inductor L1", "ohm", 0.08)
    output_resistance: Scalar = parameter("of the inductor L2", "ohm", 0.06)
    transfer_capacitance: Scalar = parameter("C1, in the middle", "F", 47e-6)
    output_capacitance: Scalar = parameter("C2, at the load", "F", 220e-6)
    source: Scalar = parameter("voltage of the source", "V", 12.0)
    load: Scalar = parameter("conductance of the load", "S", 0.1, sign="0")

    states: ClassVar = {
        "input_current": Span(0.0, 5.0, "A"),
        "transfer_voltage": Span(10.0, 40.0, "V"),
        "output_current": Span(0.0, 5.0, "A"),
    }
    outputs: ClassVar = {"voltage": Span(5.0, 20.0, "V")}
    inputs: ClassVar = {"duty": DUTY}
    unknown: ClassVar = ("load",)
    first: ClassVar = (1.2, 24.0, 1.2, 12.0)

    def f(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        (i1, v1, i2), d = (x[0], x[1], x[2]), u[0]
        drop = self.input_resistance * i1 + (1.0 - d) * v1
        rest = d * v1 - self.output_resistance * i2 - y[0]
        return [
            (self.source - drop) / self.input_inductance,
            ((1.0 - d) * i1 - d * i2) / self.transfer_capacitance,
            rest / self.output_inductance,
        ]

    def g(self, x: RealArray, y: RealArray, u: RealArray) -> list[RealArray]:
        del u
        return [(x[2] - self.load * y[0]) / self.output_capacitance]
