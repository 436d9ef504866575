"""Metrics from a plain function of a record."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import is_concrete, nonnegative, real
from .._experiment import Record
from .._kinks import below
from .._typing import PyTree
from ._base import AbstractMetric, counts

__all__ = ["Final", "Integral", "Maximum", "Mean"]


def _value(function: Callable[[Record], Array], record: Record) -> Array:
    """A real array; what is none has the precision of the time."""
    value = jnp.asarray(function(record))
    real_already = jnp.issubdtype(value.dtype, jnp.floating)
    return value if real_already else value.astype(record.t.dtype)


class Mean(AbstractMetric):
    """The mean of `function(record)`, an array of any shape (true counts as 1), over the
    samples from `after` (s) on; zero where there are none."""

    function: Callable[[Record], Array]
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def init(self, record: Record) -> PyTree:
        value = _value(self.function, record)
        counting = counts(record, self.after)
        one = jnp.where(counting, jnp.ones_like(value), 0.0)
        return one, jnp.where(counting, value, 0.0)

    def update(self, state: PyTree, record: Record) -> PyTree:
        count, total = self.init(record)
        return state[0] + count, state[1] + total

    def result(self, state: PyTree) -> PyTree:
        count, total = state
        return total / jnp.maximum(count, 1.0)


class Maximum(AbstractMetric):
    """The largest `function(record)`, entry by entry, from `after` (s) on: NaN where it is
    ever that, minus infinity where there are no samples. For the smallest, negate twice."""

    function: Callable[[Record], Array]
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def init(self, record: Record) -> PyTree:
        value = _value(self.function, record)
        return jnp.where(counts(record, self.after), value, -jnp.inf)

    def update(self, state: PyTree, record: Record) -> PyTree:
        return jnp.maximum(state, self.init(record))

    def result(self, state: PyTree) -> PyTree:
        return state


class Final(AbstractMetric):
    """`function(record)` at the last sample."""

    function: Callable[[Record], Array]

    def init(self, record: Record) -> PyTree:
        return jnp.asarray(self.function(record))

    def update(self, state: PyTree, record: Record) -> PyTree:
        del state
        return self.init(record)

    def result(self, state: PyTree) -> PyTree:
        return state


class Integral(AbstractMetric):
    """The integral over time of `function(record)`, an array of any shape, by trapezoids
    over the intervals that begin at `after` (s) or later: its units times seconds. Of a
    [`ContinuousExperiment`][] it is a state beside the others, with the same tolerance, and
    begins at `after`; where the function is not finite, the run ends there."""

    function: Callable[[Record], Array]
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def init(self, record: Record) -> PyTree:
        value = _value(self.function, record)
        return record.t, counts(record, self.after), value, jnp.zeros_like(value)

    def update(self, state: PyTree, record: Record) -> PyTree:
        t, counting, value, total = state
        now = _value(self.function, record)
        area = 0.5 * (record.t - t) * (value + now)
        total = total + jnp.where(counting, area, 0.0)
        return record.t, counts(record, self.after), now, total

    def result(self, state: PyTree) -> PyTree:
        return state[-1]

    def integrand(self, record: Record) -> PyTree:
        value = _value(self.function, record)
        if is_concrete(self.after) and not np.asarray(self.after) > 0:
            return value
        return jnp.where(below(record.t, self.after), 0.0, value)

    def of_integral(self, integral: PyTree) -> PyTree:
        return (integral,)
