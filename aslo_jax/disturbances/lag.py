"""A lag that nobody modelled."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import positive, real
from .base import AbstractDisturbance, DisturbanceState


class ParasiticLag(AbstractDisturbance):
    """Passes the signal through `tau x' = -x + signal`, x from zero; `tau` in seconds.

    Source: paper, section 2.5, "dynamic parasitic disturbances".
    """

    tau: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self):
        positive("tau", self.tau, "s")

    def init(self, t, signal, output=None):
        del t, output
        return DisturbanceState(continuous=jax.tree.map(jnp.zeros_like, signal))

    def vector_field(self, t, state, signal, output=None):
        del t, output
        return jax.tree.map(lambda x, s: (s - x) / self.tau, state.continuous, signal)

    def update(self, t, state, signal, output=None):
        del t, state, signal, output

    def __call__(self, t, state, signal, output=None):
        del t, signal, output
        assert state is not None
        return state.continuous

    @property
    def has_jumps(self):
        return False

    def jumps(self, t0, t1):
        del t0, t1
        return np.empty(0)
