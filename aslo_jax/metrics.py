"""Metrics of an experiment, computed sample by sample as it runs."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from ._checks import nonnegative, positive, real
from .experiment import Record


class AbstractMetric(eqx.Module):
    """A reduction of the records of an experiment, in the order of time.

    It runs inside the loop of every engine, so `update` should be elementwise arithmetic on
    small arrays.
    """

    @abc.abstractmethod
    def init(self, record: Record) -> PyTree:
        """The state after the first record, that of t = 0."""

    @abc.abstractmethod
    def update(self, state: PyTree, record: Record) -> PyTree:
        """The state after a further record."""

    @abc.abstractmethod
    def result(self, state: PyTree) -> PyTree:
        """The metric, from the last state."""


def _error(record: Record, observer: str) -> Float[Array, " n"]:
    return record.estimates[observer].value - record.hidden


def _counts(record: Record, after: Float[Array, ""]) -> Bool[Array, ""]:
    return record.t >= after


class RMSError(AbstractMetric):
    """The root of the mean squared error of `observer` from `after` (s) on, for each entry
    of the estimate, in its units."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self):
        nonnegative("after", self.after)

    def init(self, record):
        e = _error(record, self.observer)
        counts = jnp.where(_counts(record, self.after), 1.0, 0.0).astype(e.dtype)
        return counts, counts * e * e

    def update(self, state, record):
        count, total = state
        more, square = self.init(record)
        return count + more, total + square

    def result(self, state):
        count, total = state
        return jnp.sqrt(total / jnp.maximum(count, 1.0))


class PeakError(AbstractMetric):
    """The largest error of `observer` from `after` (s) on, in magnitude, for each entry of
    the estimate, in its units."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self):
        nonnegative("after", self.after)

    def init(self, record):
        e = _error(record, self.observer)
        return jnp.where(_counts(record, self.after), jnp.abs(e), 0.0)

    def update(self, state, record):
        return jnp.maximum(state, self.init(record))

    def result(self, state):
        return state


class FinalError(AbstractMetric):
    """The error of `observer` at the last sample, estimate less truth, shape `(n,)`."""

    observer: str = eqx.field(static=True)

    def init(self, record):
        return _error(record, self.observer)

    def update(self, state, record):
        del state
        return self.init(record)

    def result(self, state):
        return state


class SettlingTime(AbstractMetric):
    """The first instant (s) from which the error of `observer` stays within `tolerance`, in
    the Euclidean norm and the units of the estimate; infinite where it is outside at the
    end."""

    observer: str = eqx.field(static=True)
    tolerance: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self):
        positive("tolerance", self.tolerance)

    def init(self, record):
        return jnp.where(self._within(record), record.t, jnp.inf)

    def update(self, state, record):
        earliest = jnp.minimum(state, record.t)
        return jnp.where(self._within(record), earliest, jnp.inf)

    def result(self, state):
        return state

    def _within(self, record: Record) -> Bool[Array, ""]:
        e = _error(record, self.observer)
        return jnp.sum(e * e) <= self.tolerance**2


class CoastingFraction(AbstractMetric):
    """The part of the samples at which `observer` coasts, from 0 to 1."""

    observer: str = eqx.field(static=True)

    def init(self, record):
        coasts = record.estimates[self.observer].coasting
        one = jnp.ones_like(record.t)
        return one, jnp.where(coasts, one, 0.0)

    def update(self, state, record):
        count, total = self.init(record)
        return state[0] + count, state[1] + total

    def result(self, state):
        return state[1] / state[0]
