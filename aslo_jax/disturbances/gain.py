"""A wrong scale."""

import equinox as eqx
from jaxtyping import Array, Float

from .._checks import real
from .base import AbstractMemoryless


class GainError(AbstractMemoryless):
    """Multiplies the signal by `1 + error`; `error` is dimensionless, a scalar or of the
    signal's shape."""

    error: Float[Array, "*signal"] = eqx.field(converter=real)

    def __call__(self, t, state, signal, output=None):
        del t, state, output
        return signal * (1.0 + self.error)
