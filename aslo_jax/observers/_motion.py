"""The motion of a mechanical system some of whose parameters are unknown."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._module import Module
from ..plants import AbstractMechanicalSystem
from ..plants._mechanical import solve

PUSH = "push"  # a constant force on every coordinate, which no system has among its leaves


def leaf_of(system: Any, name: str) -> Any:
    """A leaf of a system by its name, fields joined by dots; `None` where it has none."""
    for field in name.split("."):
        system = getattr(system, field, None)
    return system


class Slopes(NamedTuple):
    """The derivatives of the accelerations by the positions and the velocities, shape `(n,
    n)`, by the unknown parameters, shape `(n, k)`, and by what is noise, shape `(n, w)`."""

    position: Float[Array, "n n"]
    velocity: Float[Array, "n n"]
    parameters: Float[Array, "n k"]
    noise: Float[Array, "n w"]


class Motion(Module):
    """The motion of a `system` of `n` coordinates q. `parameters` are the names of those of
    its leaves that are not known, fields joined by dots, or `"push"`, a constant force on
    every coordinate (N or N m) that is not in u; `forces` says whether there is noise of
    that kind."""

    system: AbstractMechanicalSystem
    n: int = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True, default=())
    forces: bool = eqx.field(static=True, default=False)

    def leaf(self, name: str) -> Any:
        """An unknown parameter as the system has it."""
        return jnp.zeros(self.n) if name == PUSH else leaf_of(self.system, name)

    def nominal(self, dtype: Any) -> Float[Array, " k"]:
        """The values that the system has, one after the other."""
        flat = [jnp.ravel(self.leaf(name)).astype(dtype) for name in self.parameters]
        return jnp.concatenate(flat) if flat else jnp.zeros(0, dtype)

    def values(self, parameters: Float[Array, " k"]) -> dict[str, Array]:
        """Each parameter, from all of them one after the other."""
        found, first = {}, 0
        for name in self.parameters:
            shape = jnp.shape(self.leaf(name))
            last = first + int(jnp.size(self.leaf(name)))
            found[name] = parameters[first:last].reshape(shape)
            first = last
        return found

    def acceleration(
        self,
        q: Float[Array, " n"],
        velocity: Float[Array, " n"],
        parameters: Float[Array, " k"],
        u: Float[Array, " m"],
        force: Float[Array, " n"] | None = None,
    ) -> Float[Array, " n"]:
        """`q''` with these parameters, under a `force` on every coordinate that is not in
        u."""
        system, values = self.system, self.values(parameters)
        push = values.pop(PUSH, None)
        for name, value in values.items():
            leaf = lambda system, name=name: leaf_of(system, name)
            system = eqx.tree_at(leaf, system, value)
        found = system.acceleration(q, velocity, u)
        for each in (push, force):
            if each is not None:
                found = found + solve(system.inertia(q), each)
        return found

    def slopes(
        self,
        x: Float[Array, " d"],
        parameters: Float[Array, " k"],
        u: Float[Array, " m"],
    ) -> Slopes:
        """Those at positions and velocities `x`; the noise is that of u, then of the
        forces that are not in it."""
        q, velocity = jnp.split(x, 2)
        force = jnp.zeros_like(q) if self.forces else None
        entries = (0, 1, 2, 3, 4) if self.forces else (0, 1, 2, 3)
        by = jax.jacfwd(self.acceleration, entries)(q, velocity, parameters, u, force)
        return Slopes(by[0], by[1], by[2], jnp.concatenate(by[3:], axis=1))

    def rate(
        self,
        x: Float[Array, " d"],
        parameters: Float[Array, " k"],
        u: Float[Array, " m"],
    ) -> Float[Array, " d"]:
        """The derivative of positions and velocities `x`."""
        q, velocity = jnp.split(x, 2)
        return jnp.concatenate([velocity, self.acceleration(q, velocity, parameters, u)])
