"""Hum and ripple."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import real
from .base import AbstractMemoryless


class Sinusoid(AbstractMemoryless):
    """Adds `amplitude sin(frequency t + phase)`: `amplitude` in the units of the signal,
    `frequency` in rad/s, `phase` in rad; each a scalar, or of the signal's shape."""

    amplitude: Float[Array, "*amplitude"] = eqx.field(converter=real)
    frequency: Float[Array, "*frequency"] = eqx.field(converter=real)
    phase: Float[Array, "*phase"] = eqx.field(converter=real, default=0.0)

    def __call__(self, t, state, signal, output=None):
        del state, output
        return signal + self.amplitude * jnp.sin(self.frequency * t + self.phase)
