"""Limits."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._checks import is_concrete, real
from .._kinks import clip
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, DisturbanceState

__all__ = ["Saturation"]


class Saturation(AbstractMemoryless):
    """Clips each entry to [`lower`, `upper`], in the units of the signal: scalars, or of
    its shape.

    **Raises:** `ValueError` where `lower` is not below `upper`.
    """

    lower: Float[Array, "*signal"] = eqx.field(converter=real)
    upper: Float[Array, "*signal"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        ends = self.lower, self.upper
        if all(eqx.is_array(end) for end in ends) and is_concrete(*ends):
            low, high = map(np.asarray, ends)
            if not (low < high).all():
                raise ValueError(
                    "Argument `lower` must be below `upper`, but got "
                    f"{low.tolist()} and {high.tolist()}."
                )

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state, output
        return clip(signal, self.lower, self.upper)
