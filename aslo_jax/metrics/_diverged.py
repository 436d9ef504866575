"""Whether an estimate has diverged."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import is_concrete, nonnegative, real
from .._experiment import Record
from .._typing import PyTree
from ._base import AbstractMetric, counts, squares_of

__all__ = ["Diverged"]


class Diverged(AbstractMetric):
    """Whether the error of `observer` was ever, from `after` (s) on, larger than `bound`,
    in the Euclidean norm and the units of the estimate, or not finite; a boolean. Its mean
    over a batch is the share that diverged.

    The bound is infinite by default; an error whose square overflows is then not finite.

    **Raises:** `ValueError` for a `bound` that is not positive.
    """

    observer: str = eqx.field(static=True)
    bound: Float[Array, ""] = eqx.field(converter=real, default=jnp.inf)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)
        if eqx.is_array(self.bound) and is_concrete(self.bound) and not self.bound > 0:
            raise ValueError(
                f"Argument `bound` must be positive, but got {float(self.bound)}."
            )

    def init(self, record: Record) -> PyTree:
        square = squares_of(record, self.observer, True)
        fine = jnp.isfinite(square) & (square <= self.bound**2)
        return counts(record, self.after) & ~fine

    def update(self, state: PyTree, record: Record) -> PyTree:
        return state | self.init(record)

    def result(self, state: PyTree) -> PyTree:
        return state
