"""Samples that get lost."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import random
from .._checks import is_concrete, real
from .._typing import PyTree, RealArray
from ._base import AbstractSampled, DisturbanceState

__all__ = ["MissingSamples"]


class MissingSamples(AbstractSampled):
    """Loses each sample with `probability`, in [0, 1], all its entries together, and holds
    the last one that arrived; the first one arrives.

    Whether a sample is lost depends on `key`, the sample and `stream` only. A derivative
    with respect to `probability` is zero, as it is wherever there is one.

    **Raises:** `ValueError` for a `probability` out of [0, 1].
    """

    probability: Float[Array, ""] = eqx.field(converter=real)
    key: random.Key = eqx.field(converter=random.as_key)
    stream: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        if eqx.is_array(self.probability) and is_concrete(self.probability):
            value = np.asarray(self.probability)
            if not ((value >= 0) & (value <= 1)).all():
                raise ValueError(
                    f"Argument `probability` must be in [0, 1], but got {value.tolist()}."
                )

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, output
        return DisturbanceState(sampled=(jnp.zeros((), jnp.int32), jnp.asarray(signal)))

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        return state.sampled[0] + 1, self(t, state, signal, output)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, output
        assert state is not None
        count, held = state.sampled
        return jnp.where(self._lost(count), held, signal)

    def _lost(self, count) -> Bool[Array, ""]:
        number = random.uniform(self.key, count, self.stream, dtype=self.probability.dtype)
        return number < self.probability
