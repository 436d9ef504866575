"""Signals of time in a file: loads, references, supplies."""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
from pydantic import Field

from ..control.signals import Supply, Wave
from .table import Numbers, Positive, Table, key


class WaveTable(Table):
    """`offset + amplitude sin(frequency t + phase)`."""

    offset: Numbers = key("mean, in the units of the signal", default=0.0)
    amplitude: Numbers = key("amplitude, in the units of the signal", default=0.0)
    frequency: Numbers = key("frequency", "rad/s", default=0.0)
    phase: Numbers = key("phase", "rad", default=0.0)

    def signal(self) -> Wave:
        """The wave, every parameter of the shape of the signal."""
        values = [jnp.asarray(x, float) for x in self.model_dump().values()]
        sizes = {v.shape for v in values if v.shape}
        if len(sizes) > 1:
            raise ValueError(
                "the parameters of a signal must be numbers or lists of one length, but "
                f"are {self.model_dump()}"
            )
        return Wave(*values)


NoLoad = WaveTable()


class SupplyTable(Table):
    """A turning voltage with modulated amplitude and phase."""

    kind: Literal["supply"] = key("the kind of signal")
    amplitude: Positive = key("amplitude", "V")
    frequency: float = key("frequency", "rad/s")
    depth: float = key("depth of the modulation", default=0.0)
    rate: float = key("frequency of the modulation", "rad/s", default=0.0)

    def signal(self) -> Supply:
        return Supply(**self.model_dump(exclude={"kind"}))


class WaveInput(WaveTable):
    """A wave among other signals."""

    kind: Literal["wave"] = key("the kind of signal")

    def signal(self) -> Wave:
        table: dict[str, Any] = self.model_dump(exclude={"kind"})
        return WaveTable(**table).signal()


Signal = Annotated[SupplyTable | WaveInput, Field(discriminator="kind")]
