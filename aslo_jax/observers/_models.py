"""Models of observers that copy a system: how it moves, and what is measured of it."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._module import Module
from .._typing import PyTree, RealArray
from ..plants import AbstractMechanicalSystem, FluxRelation

__all__ = ["AbstractModel", "MechanicalModel", "PMSMModel"]


class AbstractModel(Module):
    """`x' = f(x, u) + noise`, `y = h(x) + noise`."""

    @abc.abstractmethod
    def drift(self, x: Float[Array, " n"], u: PyTree) -> Float[Array, " n"]:
        """`f(x, u)`, units of x per second."""

    @abc.abstractmethod
    def output(self, x: Float[Array, " n"]) -> Float[Array, " p"]:
        """`h(x)`, what is measured."""

    @abc.abstractmethod
    def select(self, x: Float[Array, " n"]) -> Float[Array, " k"]:
        """What of x is the estimate."""

    def signals_of(self, n: int) -> dict[str, tuple[int, ...]]:
        """The shapes of u and y beside a state of n entries, where they are known."""
        del n
        return {}


class PMSMModel(AbstractModel):
    """A non-salient PMSM whose electrical speed is a random walk: `x = (flux, speed,
    angle)`, the stator flux (Wb, two entries), the electrical speed (rad/s) and the
    electrical angle (rad, unwrapped). Input the voltage (V), output the current (A), the
    estimate the stator flux (Wb), each of shape `(2,)`.

    - `relation`: of the flux and the current, with the machine's parameters.

    Source: paper, eqs. (sys) and (flucur).
    """

    relation: FluxRelation

    def drift(self, x: RealArray, u: PyTree) -> RealArray:
        flux = u - self.relation.resistance * self.output(x)
        return jnp.stack([flux[0], flux[1], jnp.zeros_like(x[2]), x[2]])

    def output(self, x: RealArray) -> RealArray:
        magnet = self.relation.magnet_flux * jnp.stack([jnp.cos(x[3]), jnp.sin(x[3])])
        return (x[:2] - magnet) / self.relation.inductance

    def select(self, x: RealArray) -> RealArray:
        return x[:2]

    def signals_of(self, n: int) -> dict[str, tuple[int, ...]]:
        return {"u": (2,), "y": (2,)}


class MechanicalModel(AbstractModel):
    """A mechanical `system`: `x = (q, q')`, input the generalised forces, shape `(m,)`,
    output the positions, estimate the velocities, each of shape `(n,)`.

    Source: paper, eq. (EL).
    """

    system: AbstractMechanicalSystem

    def drift(self, x: RealArray, u: PyTree) -> RealArray:
        q, velocity = jnp.split(x, 2)
        return jnp.concatenate([velocity, self.system.acceleration(q, velocity, u)])

    def output(self, x: RealArray) -> RealArray:
        return jnp.split(x, 2)[0]

    def select(self, x: RealArray) -> RealArray:
        return jnp.split(x, 2)[1]

    def signals_of(self, n: int) -> dict[str, tuple[int, ...]]:
        return self.system.signals_of(n // 2)
