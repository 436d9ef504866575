"""The chain of integrators: the paper's motivating example and its extension O3."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._module import Module
from .._relations import Rate
from .._typing import PyTree, RealArray
from ._base import AbstractPlant

__all__ = ["ChainRelation", "IntegratorChain"]


class ChainRelation(Module):
    """`x2 = y'`, the rate relation of a chain of `order` integrators.

    The unmeasured state is `(x2, ..., xn)`, with `x_i' = x_(i+1)` and `x_n' = u`.

    Source: paper, Prop. 1 (order 2) and O3; theory, section 2.
    """

    order: int = eqx.field(static=True)

    def __call__(self, u: Float[Array, ""], y: Float[Array, ""]) -> Rate:
        n = self.order - 1
        dtype = jnp.result_type(u, y)
        return Rate(
            c=jnp.zeros(n, dtype).at[0].set(1.0),
            s=y,
            z=jnp.zeros(n, dtype).at[-1].set(u),
            A=None if n == 1 else jnp.eye(n, k=1, dtype=dtype),
            constant=True,
        )


class IntegratorChain(AbstractPlant):
    """`x1' = x2, ..., xn' = u, y = x1`; the hidden part is `(x2, ..., xn)`.

    With `order=2` it is the double integrator of the paper's section 2.

    **Raises:** `ValueError` for an `order` below 2.
    """

    order: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        if self.order < 2:
            raise ValueError(
                f"Argument `order` must be at least 2 for a state to be hidden, but got "
                f"{self.order}."
            )

    def initial(self) -> PyTree:
        return jnp.zeros(self.order)

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        del t
        return jnp.append(x[1:], u)

    def output(self, x: PyTree) -> PyTree:
        return x[0]

    def hidden(self, x: PyTree) -> RealArray:
        return x[1:]

    def relation(self) -> ChainRelation:
        """The rate relation of the unmeasured states, for an observer."""
        return ChainRelation(self.order)
