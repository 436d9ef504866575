"""Signals of time in a file: loads, references, supplies."""

import abc
from typing import Annotated, Literal

import jax.numpy as jnp
from pydantic import Field

from ..control._signals import Supply, Wave
from ._table import Numbers, Positive, Table, key


class AbstractWaveTable(Table, abc.ABC):
    """`offset + amplitude sin(frequency t + phase)`."""

    offset: Numbers = key("mean, in the units of the signal", default=0.0)
    amplitude: Numbers = key("amplitude, in the units of the signal", default=0.0)
    frequency: Numbers = key("frequency", "rad/s", default=0.0)
    phase: Numbers = key("phase", "rad", default=0.0)

    def signal(self) -> Wave:
        """The wave, every parameter of the shape of the signal."""
        given = self.model_dump(include={"offset", "amplitude", "frequency", "phase"})
        values = {name: jnp.asarray(x, float) for name, x in given.items()}
        if len({v.shape for v in values.values() if v.shape}) > 1:
            raise ValueError(
                "the parameters of a signal must be numbers or lists of one length, but "
                f"are {given}"
            )
        return Wave(**values)


class WaveTable(AbstractWaveTable):
    """A wave by itself."""


NoLoad = WaveTable()


class SupplyTable(Table):
    """A turning voltage with modulated amplitude and phase.

    - `kind`: `"supply"`; `amplitude` (V) and `frequency` (rad/s) of the voltage;
    - `depth`: of the modulation, without a unit; `rate`: its frequency (rad/s).
    """

    kind: Literal["supply"] = key("the kind of signal")
    amplitude: Positive = key("amplitude", "V")
    frequency: float = key("frequency", "rad/s")
    depth: float = key("depth of the modulation", default=0.0)
    rate: float = key("frequency of the modulation", "rad/s", default=0.0)

    def signal(self) -> Supply:
        return Supply(**self.model_dump(exclude={"kind"}))


class WaveInput(AbstractWaveTable):
    """A wave among other signals; `kind` is `"wave"`."""

    kind: Literal["wave"] = key("the kind of signal")


Signal = Annotated[SupplyTable | WaveInput, Field(discriminator="kind")]
