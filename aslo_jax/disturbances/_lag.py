"""A lag that nobody modelled."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import HostArray, PyTree, RealArray
from ._base import AbstractDisturbance, DisturbanceState

__all__ = ["ParasiticLag"]


class ParasiticLag(AbstractDisturbance):
    """Passes the signal through `tau x' = -x + signal`, x from zero; `tau` in seconds.

    Source: paper, section 2.5, "dynamic parasitic disturbances".
    """

    tau: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        positive("tau", self.tau, "s")

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, output
        return DisturbanceState(continuous=jax.tree.map(jnp.zeros_like, signal))

    def vector_field(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, output
        return jax.tree.map(lambda x, s: (s - x) / self.tau, state.continuous, signal)

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
        del t, signal, output
        assert state is not None
        return state.continuous

    @property
    def has_jumps(self) -> bool:
        return False

    def jumps(self, t0: float, t1: float) -> HostArray:
        del t0, t1
        return np.empty(0)
