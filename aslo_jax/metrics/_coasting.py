"""How long an observer coasts."""

import equinox as eqx
import jax.numpy as jnp

from .._experiment import Record
from .._typing import PyTree
from ._base import AbstractMetric, estimate_of

__all__ = ["CoastingFraction"]


class CoastingFraction(AbstractMetric):
    """The part of the samples at which `observer` coasts, from 0 to 1."""

    observer: str = eqx.field(static=True)

    def init(self, record: Record) -> PyTree:
        coasts = estimate_of(record, self.observer).coasting
        one = jnp.ones_like(record.t)
        return one, jnp.where(coasts, one, 0.0)

    def update(self, state: PyTree, record: Record) -> PyTree:
        count, total = self.init(record)
        return state[0] + count, state[1] + total

    def result(self, state: PyTree) -> PyTree:
        return state[1] / state[0]
