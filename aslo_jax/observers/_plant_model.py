"""Plants as the models of observers that copy them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._typing import PyTree, RealArray
from ..plants import AbstractMachine, AbstractVectorPlant, MachineState
from ._models import AbstractModel

__all__ = ["MachineModel", "PlantModel"]


class PlantModel(AbstractModel):
    """A `plant` with its unknown parameters as states: x is the state of the plant with
    these after its `states`, the estimate its hidden part."""

    plant: AbstractVectorPlant

    def at(self, x: Float[Array, " n"]) -> tuple[AbstractVectorPlant, Float[Array, " s"]]:
        """The plant with the parameters in x, and its state."""
        names, n = self.plant.unknown, len(self.plant.states)
        state = jnp.concatenate([x[:n], x[n + len(names) :]])
        if not names:
            return self.plant, state
        constants = [x[n + k] for k in range(len(names))]
        where = lambda plant: [getattr(plant, name) for name in names]
        return eqx.tree_at(where, self.plant, constants), state

    def joined(self, state: Float[Array, " s"]) -> Float[Array, " n"]:
        """The x of a state of the plant, with the plant's own parameters."""
        n = len(self.plant.states)
        constants = [jnp.asarray(c, state.dtype)[None] for c in self.plant.constants()]
        return jnp.concatenate([state[:n], *constants, state[n:]])

    def drift(self, x: RealArray, u: PyTree) -> RealArray:
        plant, state = self.at(x)
        n, k = len(plant.states), len(plant.unknown)
        rate = plant.vector_field(jnp.zeros((), x.dtype), state, u)
        return jnp.concatenate([rate[:n], jnp.zeros(k, x.dtype), rate[n:]])

    def output(self, x: RealArray) -> RealArray:
        plant, state = self.at(x)
        return plant.output(state)

    def select(self, x: RealArray) -> RealArray:
        return x[: len(self.plant.states) + len(self.plant.unknown)]

    def signals_of(self, n: int) -> dict[str, tuple[int, ...]]:
        return {"u": (len(self.plant.inputs),), "y": (len(self.plant.outputs),)}

    def spans(self) -> Float[Array, " n"]:
        """Half the range of every entry of x; of a parameter, half of its value, or of one
        where that is zero."""
        half = jnp.asarray([0.5 * (s.high - s.low) for s in self.plant.moving().values()])
        constants = [jnp.abs(c)[None] for c in self.plant.constants()]
        n = len(self.plant.states)
        sizes = [0.5 * jnp.where(c > 0, c, 1.0) for c in constants]
        return jnp.concatenate([half[:n], *sizes, half[n:]])


class MachineModel(AbstractModel):
    """Any electrical `machine` whose speed is a random walk: `x = (flux, speed, angle)`,
    the flux linkages (Wb), the electrical speed (rad/s) and the electrical angle (rad,
    unwrapped). Input the voltages (V), output the currents (A), the estimate the flux, of
    as many entries as the machine has windings.

    Source: paper, O5.
    """

    machine: AbstractMachine

    def drift(self, x: RealArray, u: PyTree) -> RealArray:
        flux = self.machine.flux_rate(u, self.output(x))
        return jnp.concatenate([flux, jnp.zeros_like(x[-2:-1]), x[-2:-1]])

    def output(self, x: RealArray) -> RealArray:
        angle = x[-1] / self.machine.pole_pairs
        return self.machine.output(MachineState(x[:-2], x[-2], angle))

    def select(self, x: RealArray) -> RealArray:
        return x[:-2]


def linearised(model: PlantModel, u: Any, x: Any) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobians of drift and output at an x and an input."""
    A = jax.jacfwd(model.drift)(x, u)
    return np.asarray(A), np.asarray(jax.jacfwd(model.output)(x))
