"""Disturbances between controller, plant and observers, as modules."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from . import random
from ._checks import positive, real


class AbstractDisturbance(eqx.Module):
    """Something a signal passes through, with a state of its own where it needs one."""

    @abc.abstractmethod
    def init(self, signal: PyTree) -> PyTree:
        """The state at the first instant."""

    @abc.abstractmethod
    def vector_field(self, t: Float[Array, ""], state: PyTree, signal: PyTree) -> PyTree:
        """The derivative of the state at time t (s)."""

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""], state: PyTree, signal: PyTree) -> PyTree:
        """The disturbed signal."""

    @property
    @abc.abstractmethod
    def has_jumps(self) -> bool:
        """Whether the disturbed signal is held and jumps at known instants."""

    @abc.abstractmethod
    def jumps(self, t0: float, t1: float) -> Float[np.ndarray, " jumps"]:
        """The instants in (t0, t1) at which it jumps (s), for the solver to stop at."""


class SampledNoise(AbstractDisturbance):
    """Adds white noise that is sampled and held: `deviation` times a standard normal
    number, renewed every `interval` seconds.

    White noise of two-sided intensity W (unit squared times second) has
    `deviation = sqrt(W / interval)`. Numbers are keyed by `key` and counted by the time
    index and `stream`, so two noises of one study need different streams.
    """

    deviation: Float[Array, "*signal"] = eqx.field(converter=real)
    interval: float = eqx.field(static=True)
    key: random.Key
    stream: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        positive("interval", self.interval, "s")

    def init(self, signal):
        del signal

    def vector_field(self, t, state, signal):
        del t, state, signal

    def __call__(self, t, state, signal):
        del state
        signal = jnp.asarray(signal)
        index = held_index(t, self.interval)
        noise = random.normal(
            self.key, index, self.stream, signal.shape, self.deviation.dtype
        )
        return signal + self.deviation * noise

    @property
    def has_jumps(self):
        return True

    def jumps(self, t0, t1):
        first, last = int(np.floor(t0 / self.interval)), int(np.ceil(t1 / self.interval))
        times = np.arange(first, last + 1) * self.interval
        return times[(times > t0) & (times < t1)]


class ParasiticLag(AbstractDisturbance):
    """Passes the signal through `tau x' = -x + signal`, x from zero; `tau` in seconds.

    Source: paper, section 2.5, "dynamic parasitic disturbances".
    """

    tau: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self):
        positive("tau", self.tau, "s")

    def init(self, signal):
        return jax.tree.map(jnp.zeros_like, signal)

    def vector_field(self, t, state, signal):
        del t
        return jax.tree.map(lambda x, s: (s - x) / self.tau, state, signal)

    def __call__(self, t, state, signal):
        del t, signal
        return state

    @property
    def has_jumps(self):
        return False

    def jumps(self, t0, t1):
        return np.empty(0)


class Encoder(AbstractDisturbance):
    """Rounds each entry of a signal of shape `(p,)` to a multiple of `resolution`, as an
    encoder does, and reports angles within one turn, in [0, 2 pi).

    - `resolution`: in the units of each entry, shape `(p,)`; for an angle `2 pi / 2**bits`;
    - `angles`: for each entry, whether it is an angle (rad); empty where none is.

    For sampled loops: in continuous time its jumps come at instants that no solver knows.
    """

    resolution: Float[Array, " p"] = eqx.field(converter=real)
    angles: tuple[bool, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        positive("resolution", self.resolution)

    def init(self, signal):
        del signal

    def vector_field(self, t, state, signal):
        del t, state, signal

    def __call__(self, t, state, signal):
        del t, state
        counts = jnp.round(signal / self.resolution)
        if not self.angles:
            return counts * self.resolution
        turn = jnp.round(2.0 * jnp.pi / self.resolution)
        within = jnp.where(jnp.asarray(self.angles), counts % turn, counts)
        return within * self.resolution

    @property
    def has_jumps(self):
        return False

    def jumps(self, t0, t1):
        return np.empty(0)


def held_index(t: Float[Array, ""], interval: float) -> Array:
    """The k of `k interval <= t < (k + 1) interval`, exact in floating point."""
    k = jnp.floor(t / interval)
    k = jnp.where((k + 1.0) * interval <= t, k + 1.0, k)
    k = jnp.where(k * interval > t, k - 1.0, k)
    return k.astype(jnp.int32)
