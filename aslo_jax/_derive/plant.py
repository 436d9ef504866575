"""A model as a plant, to simulate."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._typing import PyTree
from ..plants import AbstractPlant
from .model import Model


class ModelPlant(AbstractPlant):
    """A `model` all of whose outputs have rates: its state is what is not measured, unknown
    parameters the last ones, and then what is.

    **Raises:** `ValueError` for a model with an output of which no rate is known.
    """

    model: Model = eqx.field(static=True)

    def initial(self) -> PyTree:
        pairs = [*self.model.ranges.values(), *self.model.outputs.values()]
        return jnp.array([0.5 * (low + high) for low, high in pairs], float)

    def vector_field(self, t: Float[Array, ""], x: PyTree, u: PyTree) -> PyTree:
        del t
        n = len(self.model.ranges)
        signals = x[:n], x[n:], u, jnp.asarray(self.model.values())
        rates = self.model.measured_rates(*signals)
        if len(rates) < len(self.model.outputs):
            names = [n for k, n in enumerate(self.model.outputs) if k not in rates]
            raise ValueError(
                "Argument `g` of a model must give the rates of all outputs for it to be "
                f"simulated, but gives none of {', '.join(names)}."
            )
        return jnp.stack([*self.model.rates(*signals), *rates.values()])

    def output(self, x: PyTree) -> PyTree:
        return x[len(self.model.ranges) :]

    def hidden(self, x: PyTree) -> Float[Array, " n"]:
        return x[: len(self.model.ranges)]

    def no_input(self, y: PyTree) -> Any:
        return jnp.zeros(len(self.model.inputs), jnp.result_type(y))
