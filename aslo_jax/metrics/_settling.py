"""When an estimate has settled."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._experiment import Record
from .._typing import PyTree
from ._base import AbstractMetric, squares_of

__all__ = ["SettlingTime"]


class SettlingTime(AbstractMetric):
    """The first instant (s) from which the error of `observer` stays within `tolerance`, in
    the Euclidean norm and the units of the estimate; infinite where it is outside at the
    end, or not a number."""

    observer: str = eqx.field(static=True)
    tolerance: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        positive("tolerance", self.tolerance)

    def init(self, record: Record) -> PyTree:
        return jnp.where(self._within(record), record.t, jnp.inf)

    def update(self, state: PyTree, record: Record) -> PyTree:
        earliest = jnp.minimum(state, record.t)
        return jnp.where(self._within(record), earliest, jnp.inf)

    def result(self, state: PyTree) -> PyTree:
        return state

    def _within(self, record: Record):
        return squares_of(record, self.observer, True) <= self.tolerance**2
