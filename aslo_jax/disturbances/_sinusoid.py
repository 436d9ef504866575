"""Hum and ripple."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import real
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, DisturbanceState

__all__ = ["Sinusoid"]


class Sinusoid(AbstractMemoryless):
    """Adds `amplitude sin(frequency t + phase)`: `amplitude` in the units of the signal,
    `frequency` in rad/s, `phase` in rad; each a scalar, or of the signal's shape."""

    amplitude: Float[Array, "*amplitude"] = eqx.field(converter=real)
    frequency: Float[Array, "*frequency"] = eqx.field(converter=real)
    phase: Float[Array, "*phase"] = eqx.field(converter=real, default=0.0)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del state, output
        return signal + self.amplitude * jnp.sin(self.frequency * t + self.phase)
