"""Offsets: constant, in proportion to time, and wandering."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import random
from .._checks import real
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, AbstractSampled, DisturbanceState

__all__ = ["Bias", "Drift", "RandomWalk"]


class Bias(AbstractMemoryless):
    """Adds the constant `offset`, in the units of the signal: a scalar, or of its shape."""

    offset: Float[Array, "*signal"] = eqx.field(converter=real)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state, output
        return signal + self.offset


class Drift(AbstractMemoryless):
    """Adds `rate` times the time since t = 0, in units of the signal per second: a scalar,
    or of its shape."""

    rate: Float[Array, "*signal"] = eqx.field(converter=real)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del state, output
        return signal + self.rate * t


class RandomWalk(AbstractSampled):
    """Adds a random walk from zero, each step of it `deviation` times a standard normal
    number, one step from a sample to the next.

    A walk of intensity W (unit squared per second) has `deviation = sqrt(W * interval)`, in
    the unit of the signal, shape `()` or that of the signal. Numbers are keyed by `key` and
    counted by the sample and `stream`.
    """

    deviation: Float[Array, "*signal"] = eqx.field(converter=real)
    key: random.Key = eqx.field(converter=random.as_key)
    stream: int = eqx.field(static=True, default=1)

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, output
        walk = jnp.zeros(jnp.shape(signal), self.deviation.dtype)
        return DisturbanceState(sampled=(jnp.zeros((), jnp.int32), walk))

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, signal, output
        count, walk = state.sampled
        noise = random.normal(self.key, count, self.stream, walk.shape, walk.dtype)
        return count + 1, walk + self.deviation * noise

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, output
        assert state is not None
        return signal + state.sampled[1]
