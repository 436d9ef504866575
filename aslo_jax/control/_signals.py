"""Signals of time whose parameters can be spread: loads, references, supplies."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import real
from .._module import Module


class Wave(Module):
    """`offset + amplitude sin(frequency t + phase)`, entry by entry.

    - `offset` and `amplitude` in the units of the signal, `frequency` (rad/s), `phase`
      (rad), each of shape `()` or that of the signal.
    """

    offset: Float[Array, "*signal"] = eqx.field(converter=real, default=0.0)
    amplitude: Float[Array, "*signal"] = eqx.field(converter=real, default=0.0)
    frequency: Float[Array, "*signal"] = eqx.field(converter=real, default=0.0)
    phase: Float[Array, "*signal"] = eqx.field(converter=real, default=0.0)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "*signal"]:
        wave = jnp.sin(self.frequency * t + self.phase)
        return self.offset + self.amplitude * wave


class Supply(Module):
    """A two-phase voltage that turns, `a(t) [cos b(t), sin b(t)]`, shape `(2,)`, with
    modulated amplitude and phase:

        a = amplitude (1 + depth sin(r t)),   b = frequency t + depth sin(2/3 r t)

    - `amplitude` (V), `frequency` (rad/s); `depth` of the modulation (of the amplitude, and
      rad of the phase) and its `rate` r (rad/s).
    """

    amplitude: Float[Array, ""] = eqx.field(converter=real)
    frequency: Float[Array, ""] = eqx.field(converter=real)
    depth: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    rate: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, " 2"]:
        angle = self.frequency * t + self.depth * jnp.sin(2.0 / 3.0 * self.rate * t)
        size = self.amplitude * (1.0 + self.depth * jnp.sin(self.rate * t))
        return size * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
