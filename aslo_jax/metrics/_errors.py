"""Metrics of the estimation error."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import nonnegative, real
from .._experiment import Record
from .._typing import PyTree
from ._base import AbstractComposed, AbstractMetric, counts, error_of, size, squares_of
from ._functions import Integral, Mean

__all__ = ["FinalError", "IntegralSquaredError", "MeanError", "PeakError", "RMSError"]


class RMSError(AbstractMetric):
    """The root of the mean squared error of `observer` from `after` (s) on, in the units of
    the estimate: of each of its entries, or of the Euclidean `norm`. Infinite where the
    error was not finite."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    norm: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def init(self, record: Record) -> PyTree:
        counting = counts(record, self.after)
        # Left out before it is squared: adding a square is then one rounding.
        e = jnp.where(counting, error_of(record, self.observer), 0.0)
        square = jnp.sum(e * e) if self.norm else e * e
        return jnp.where(counting, 1.0, 0.0).astype(e.dtype), square

    def update(self, state: PyTree, record: Record) -> PyTree:
        count, total = state
        more, square = self.init(record)
        return count + more, total + square

    def result(self, state: PyTree) -> PyTree:
        count, total = state
        return size(jnp.sqrt(total / jnp.maximum(count, 1.0)))


class PeakError(AbstractMetric):
    """The largest error of `observer` from `after` (s) on, in magnitude, in the units of
    the estimate: of each of its entries, or the Euclidean `norm`. Infinite where the error
    was not finite; zero where there are no samples."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    norm: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def init(self, record: Record) -> PyTree:
        if self.norm:
            # Squared up to the result: the root has no derivative at zero.
            e = squares_of(record, self.observer, True)
        else:
            e = error_of(record, self.observer)
        return jnp.where(counts(record, self.after), size(e), 0.0)

    def update(self, state: PyTree, record: Record) -> PyTree:
        return jnp.maximum(state, self.init(record))

    def result(self, state: PyTree) -> PyTree:
        return jnp.sqrt(state) if self.norm else state


class FinalError(AbstractMetric):
    """The error of `observer` at the last sample, in the units of the estimate: estimate
    less truth, shape `(n,)`, or its Euclidean `norm`, infinite where it is not finite."""

    observer: str = eqx.field(static=True)
    norm: bool = eqx.field(static=True, default=False)

    def init(self, record: Record) -> PyTree:
        return error_of(record, self.observer)

    def update(self, state: PyTree, record: Record) -> PyTree:
        del state
        return self.init(record)

    def result(self, state: PyTree) -> PyTree:
        return size(jnp.sqrt(jnp.sum(state * state))) if self.norm else state


class MeanError(AbstractComposed):
    """The bias of `observer`: its mean error from `after` (s) on, in the units of the
    estimate, shape `(n,)`, or the Euclidean `norm` of that. Not finite where the error was
    not."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    norm: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def result(self, state: PyTree) -> PyTree:
        mean = self.inner().result(state)
        return jnp.sqrt(jnp.sum(mean * mean)) if self.norm else mean

    def inner(self) -> Mean:
        return Mean(lambda record: error_of(record, self.observer), self.after)


class IntegralSquaredError(AbstractComposed):
    """The integral over time of the squared error of `observer` from `after` (s) on, in
    squared units of the estimate times seconds: of each of its entries, or of the Euclidean
    `norm`. Infinite where the error was not finite."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    norm: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def result(self, state: PyTree) -> PyTree:
        return size(self.inner().result(state))

    def inner(self) -> Integral:
        return Integral(lambda r: squares_of(r, self.observer, self.norm), self.after)
