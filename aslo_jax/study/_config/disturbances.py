"""`[[sensor]]`, `[[input_sensor]]` and `[[actuator]]` of a study: each a list, passed
through in its order."""

import abc
from typing import Annotated, Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import Field

from ... import disturbances, random
from ...disturbances import AbstractDisturbance
from ...schema import NonNegative, Numbers, Positive, Table, key

Share = Annotated[float, Field(ge=0, le=1)]
Several = NonNegative | Annotated[list[NonNegative], Field(min_length=1)]
LONGEST = 256  # samples of a delay, each an operation of every step
SEVERAL = "a finite number that is not negative, or one for each entry of the signal"


class AbstractDisturbanceTable(Table, abc.ABC):
    """A disturbance; `places` are where it may stand, `sampled` why it needs samples, where
    it does."""

    kind: Any
    places: ClassVar[tuple[str, ...]] = ("sensor", "input_sensor", "actuator")
    sampled: ClassVar[str | None] = None

    @abc.abstractmethod
    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        """The disturbance of a loop with that sampling `interval` (s), its random numbers
        those of the `stream`."""


class NoiseTable(AbstractDisturbanceTable):
    """White noise, sampled."""

    kind: Literal["noise"] = key("the kind of disturbance")
    deviation: Several = key("standard deviation per sample", allowed=SEVERAL)

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        deviation = jnp.asarray(self.deviation, float)
        return disturbances.SampledNoise(deviation, interval, random.key(0), stream)


class BiasTable(AbstractDisturbanceTable):
    """A constant offset."""

    kind: Literal["bias"] = key("the kind of disturbance")
    offset: Numbers = key("what is added")

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.Bias(jnp.asarray(self.offset, float))


class DriftTable(AbstractDisturbanceTable):
    """An offset that grows."""

    kind: Literal["drift"] = key("the kind of disturbance")
    rate: Numbers = key("what is added in every second")

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.Drift(jnp.asarray(self.rate, float))


class SinusoidTable(AbstractDisturbanceTable):
    """A sinusoid that is added."""

    kind: Literal["sinusoid"] = key("the kind of disturbance")
    amplitude: Numbers = key("amplitude")
    frequency: Numbers = key("frequency", "rad/s")
    phase: Numbers = key("phase", "rad", default=0.0)

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        values = (self.amplitude, self.frequency, self.phase)
        return disturbances.Sinusoid(*(jnp.asarray(x, float) for x in values))


class GainTable(AbstractDisturbanceTable):
    """A wrong gain."""

    kind: Literal["gain"] = key("the kind of disturbance")
    error: Numbers = key("relative error, 0.01 for 1 % too much")

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.GainError(jnp.asarray(self.error, float))


class QuantisationTable(AbstractDisturbanceTable):
    """The steps of a converter."""

    kind: Literal["quantisation"] = key("the kind of disturbance")
    step: Positive | Annotated[list[Positive], Field(min_length=1)] = key(
        "its steps", allowed="a positive finite number, or one for each entry"
    )

    sampled = "its steps come at instants that no solver knows"

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.Quantisation(jnp.asarray(self.step, float))


class EncoderTable(AbstractDisturbanceTable):
    """Encoders, one for each coordinate."""

    kind: Literal["encoder"] = key("the kind of disturbance")
    bits: Annotated[int, Field(gt=0, le=52)] = key(
        "of every encoder", allowed="a whole number from 1 to 52"
    )
    ranges: Annotated[list[Positive], Field(min_length=1)] = key(
        "what each spans, a length (m) or 0 of `angles` a turn",
        allowed="a list of positive finite numbers, one for each entry of the signal",
    )
    angles: list[bool] = key("which of them turn, within one turn (rad)", default=[])

    places = ("sensor",)
    sampled = "its counts come at instants that no solver knows"

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        resolution = np.asarray(self.ranges, float) / 2.0**self.bits
        return disturbances.Encoder(jnp.asarray(resolution), tuple(self.angles))


class DelayTable(AbstractDisturbanceTable):
    """A delay of whole or fractional samples."""

    kind: Literal["delay"] = key("the kind of disturbance")
    delay: Annotated[float, Field(ge=0, le=LONGEST)] = key(
        "in samples", allowed=f"a number from 0 to {LONGEST}"
    )
    longest: Annotated[int, Field(gt=0, le=LONGEST)] | None = key(
        "the most that a spread gives, in samples",
        default=None,
        allowed=f"a whole number from 1 to {LONGEST}",
    )

    sampled = "it is a delay of samples"

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.Delay(self.delay, self.longest)


class LagTable(AbstractDisturbanceTable):
    """A parasitic lag of the input."""

    kind: Literal["lag"] = key("the kind of disturbance")
    tau: Positive = key("time constant", "s")

    places = ("actuator",)

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.ParasiticLag(self.tau)


class SaturationTable(AbstractDisturbanceTable):
    """Limits."""

    kind: Literal["saturation"] = key("the kind of disturbance")
    lower: Numbers = key("the least value")
    upper: Numbers = key("the largest value")

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        limits = (self.lower, self.upper)
        return disturbances.Saturation(*(jnp.asarray(x, float) for x in limits))


class DeadTimeTable(AbstractDisturbanceTable):
    """The dead time of a motor's inverter."""

    kind: Literal["dead_time"] = key("the kind of disturbance")
    voltage: NonNegative = key("of the DC link, times dead time over switching period", "V")
    threshold: Positive = key("current below which it is in proportion", "A")

    places = ("actuator",)

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.DeadTime(self.voltage, self.threshold)


class MissingTable(AbstractDisturbanceTable):
    """Samples that get lost."""

    kind: Literal["missing"] = key("the kind of disturbance")
    probability: Share = key("that a sample is lost")

    places = ("sensor", "input_sensor")
    sampled = "what gets lost is a sample"

    def build(self, interval: float, stream: int) -> AbstractDisturbance:
        return disturbances.MissingSamples(self.probability, random.key(0), stream)


Disturbance = Annotated[
    NoiseTable
    | BiasTable
    | DriftTable
    | SinusoidTable
    | GainTable
    | QuantisationTable
    | EncoderTable
    | DelayTable
    | LagTable
    | SaturationTable
    | DeadTimeTable
    | MissingTable,
    Field(discriminator="kind"),
]


def chained(
    tables: list[Any], interval: float, first_stream: int
) -> AbstractDisturbance | None:
    """The disturbances of a list as one."""
    parts = [table.build(interval, first_stream + k) for k, table in enumerate(tables)]
    if len(parts) < 2:
        return parts[0] if parts else None
    return disturbances.Chain(*parts)
