"""The protocol of every plant."""

import abc

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._module import Module
from .._typing import PyTree

__all__ = ["AbstractPlant"]


class AbstractPlant(Module):
    """A system `x' = f(t, x, u)` with measured output `y` and a hidden part to estimate.

    A plant is its parameters, in SI units; its state is a value.
    """

    @abc.abstractmethod
    def initial(self) -> PyTree:
        """The default state at the first instant."""

    @abc.abstractmethod
    def vector_field(self, t: Float[Array, ""], x: PyTree, u: PyTree) -> PyTree:
        """`dx/dt` at time `t` (s)."""

    @abc.abstractmethod
    def output(self, x: PyTree) -> PyTree:
        """The measurement y; it has no direct feed-through of u."""

    @abc.abstractmethod
    def hidden(self, x: PyTree) -> Float[Array, " n"]:
        """The unmeasured state that an observer estimates, shape `(n,)`."""

    def no_input(self, y: PyTree) -> PyTree:
        """The input zero, beside the measurement y: of the shape of y, where a plant does
        not say otherwise."""
        return jax.tree.map(jnp.zeros_like, y)


def check_first(plant: AbstractPlant, x: PyTree) -> None:
    """Refuse a first state that is not like that of the plant."""
    own = jax.eval_shape(plant.initial)
    shapes = [jax.tree.map(jnp.shape, each) for each in (own, x)]
    if jax.tree.structure(own) != jax.tree.structure(x) or shapes[0] != shapes[1]:
        raise ValueError(
            f"Argument `initial` must be a state of the `{type(plant).__name__}`, of the "
            f"shape {shapes[0]}, but got {shapes[1]}."
        )
