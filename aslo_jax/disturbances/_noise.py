"""White noise."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import random
from .._checks import nonnegative, positive, real
from .._typing import HostArray, PyTree, RealArray
from ._base import AbstractDisturbance, DisturbanceState

__all__ = ["SampledNoise", "held_index"]


class SampledNoise(AbstractDisturbance):
    """Adds white noise that is sampled and held: `deviation` times a standard normal
    number, renewed every `interval` seconds.

    White noise of two-sided intensity W (unit squared times second) has
    `deviation = sqrt(W / interval)`, in the unit of the signal, shape `()` or that of the
    signal. Numbers are keyed by `key` and counted by the time index and `stream`, so two
    noises of one study need different streams.
    """

    deviation: Float[Array, "*signal"] = eqx.field(converter=real)
    interval: float = eqx.field(static=True)
    key: random.Key = eqx.field(converter=random.as_key)
    stream: int = eqx.field(static=True, default=0)

    def __check_init__(self) -> None:
        positive("interval", self.interval, "s")
        nonnegative("deviation", self.deviation)

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, signal, output
        return DisturbanceState()

    def vector_field(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, state, signal, output

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, state, signal, output

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del state, output
        signal = jnp.asarray(signal)
        index = held_index(t, self.interval)
        noise = random.normal(
            self.key, index, self.stream, signal.shape, self.deviation.dtype
        )
        return signal + self.deviation * noise

    @property
    def has_jumps(self) -> bool:
        return True

    def jumps(self, t0: float, t1: float) -> HostArray:
        first, last = int(np.floor(t0 / self.interval)), int(np.ceil(t1 / self.interval))
        times = np.arange(first, last + 1) * self.interval
        return times[(times > t0) & (times < t1)]


def held_index(t: Float[Array, ""], interval: float) -> Array:
    """The k of `k interval <= t < (k + 1) interval`, exact in floating point as long as
    that can count the intervals: up to 2**53 of them in float64, 2**24 in float32."""
    k = jnp.floor(t / interval)
    k = jnp.where((k + 1.0) * interval <= t, k + 1.0, k)
    k = jnp.where(k * interval > t, k - 1.0, k)
    return k.astype(jnp.int64 if k.dtype == jnp.float64 else jnp.int32)
