"""Delays of whole and fractional samples."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import is_concrete, real, whole
from .._typing import PyTree, RealArray
from ._base import AbstractSampled, DisturbanceState

__all__ = ["Delay"]


class Delay(AbstractSampled):
    """Delays the signal s by `delay` samples, a number that may have a fraction and may be
    traced: `(1 - f) s[k - n] + f s[k - n - 1]`, n its whole part and f its fraction, which
    is on the straight line between two samples.

    Of a sensor that is linear interpolation. Of an actuator, whose command is held, it is
    the mean over the interval of the command delayed by that fraction.

    - `delay`: in samples, in [0, `longest`], shape `()`; a derivative at a whole number is
      that to its right, at `longest` to its left;
    - `longest`: how many samples are kept, at least 1; by default those that `delay` needs.

    Before the first sample the signal is taken to have been what it is there.

    **Raises:** `ValueError` for a `delay` out of its range, and for a traced one without
    `longest`.
    """

    delay: Float[Array, ""] = eqx.field(converter=real)
    longest: int = eqx.field(static=True)

    def __init__(self, delay: Float[Array, ""] | float, longest: int | None = None) -> None:
        self.delay = real(delay)
        if longest is None:
            if not is_concrete(delay):
                raise ValueError(
                    "Argument `longest` must be given where `delay` is traced, since the "
                    "number of samples to keep depends on it, but got None."
                )
            value = float(delay)
            longest = max(math.ceil(value), 1) if math.isfinite(value) else 1
        self.longest = longest

    def __check_init__(self) -> None:
        whole("longest", self.longest)
        if eqx.is_array(self.delay) and is_concrete(self.delay):
            value = np.asarray(self.delay)
            if not ((value >= 0) & (value <= self.longest)).all():
                raise ValueError(
                    f"Argument `delay` must be in [0, {self.longest}] samples, but got "
                    f"{value.tolist()}."
                )

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, output
        signal = jnp.asarray(signal)
        past = jnp.broadcast_to(signal, (self.longest, *signal.shape))
        return DisturbanceState(sampled=past)

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, output
        return self._values(state, signal)[:-1]

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, output
        values = self._values(state, signal)
        last = self.longest - 1
        delay = jnp.where(self.delay < 0.0, 0.0, self.delay)
        delay = jnp.where(delay > self.longest, self.longest, delay)
        begin = jnp.minimum(jnp.floor(delay), last)
        fraction = delay - begin
        later, earlier = values[last], values[last + 1]
        for k in reversed(range(last)):  # selected, so that whole delays are exact
            here = begin == k
            later = jnp.where(here, values[k], later)
            earlier = jnp.where(here, values[k + 1], earlier)
        # Two products, because a difference would round where the fraction is 1.
        return (1.0 - fraction) * later + fraction * earlier

    def _values(self, state, signal):
        """The signal now and before, newest first."""
        return jnp.concatenate([jnp.asarray(signal)[None], state.sampled])
