"""Signals in steps: converters and encoders."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, DisturbanceState

__all__ = ["Encoder", "Quantisation"]


class Quantisation(AbstractMemoryless):
    """Rounds each entry to a multiple of `step` (its units; scalar or of the signal's
    shape), as an analogue-to-digital converter does; halves go to the even multiple.

    For sampled loops: in continuous time its jumps come at instants that no solver knows.
    The derivative with respect to the signal is zero, as it is wherever there is one.
    """

    step: Float[Array, "*signal"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        positive("step", self.step)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state, output
        return jnp.round(signal / self.step) * self.step


class Encoder(AbstractMemoryless):
    """Rounds each entry of a signal of shape `(p,)` to a multiple of `resolution`, as an
    encoder does, and reports angles within one turn, in [0, 2 pi).

    - `resolution`: in the units of each entry, shape `(p,)`; for an angle `2 pi / 2**bits`;
    - `angles`: for each entry, whether it is an angle (rad); empty where none is.

    For sampled loops: in continuous time its jumps come at instants that no solver knows.
    """

    resolution: Float[Array, " p"] = eqx.field(converter=real)
    angles: tuple[bool, ...] = eqx.field(static=True, default=())

    def __check_init__(self) -> None:
        positive("resolution", self.resolution)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state, output
        counts = jnp.round(signal / self.resolution)
        if not self.angles:
            return counts * self.resolution
        turn = jnp.round(2.0 * jnp.pi / self.resolution)
        within = jnp.where(jnp.asarray(self.angles), counts % turn, counts)
        return within * self.resolution
