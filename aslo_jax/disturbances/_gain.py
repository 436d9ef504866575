"""A wrong scale."""

import equinox as eqx
from jaxtyping import Array, Float

from .._checks import real
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, DisturbanceState

__all__ = ["GainError"]


class GainError(AbstractMemoryless):
    """Multiplies the signal by `1 + error`; `error` is dimensionless, a scalar or of the
    signal's shape."""

    error: Float[Array, "*signal"] = eqx.field(converter=real)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state, output
        return signal * (1.0 + self.error)
