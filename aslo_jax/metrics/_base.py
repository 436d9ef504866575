"""The protocol of every metric."""

import abc
import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import function, kind, unlike
from .._experiment import Record
from .._module import Module
from .._typing import PyTree

__all__ = [
    "AbstractComposed",
    "AbstractMetric",
    "MakeMetric",
    "PerObserver",
    "counts",
    "error_of",
    "estimate_of",
    "metric_of",
    "metric_of_each",
    "size",
    "squares_of",
]


class AbstractMetric(Module):
    """A reduction of the records of an experiment, in the order of time.

    It runs inside the loop of every engine, so `update` should be elementwise arithmetic on
    small arrays. Each sample of a batch has a state of its own, so that one that diverges
    leaves the others alone.
    """

    def __check_init__(self) -> None:
        name, made_of = getattr(self, "observer", None), getattr(self, "function", None)
        kind("observer", name, str, hint="the name of an observer")
        function("function", made_of)

    @abc.abstractmethod
    def init(self, record: Record) -> PyTree:
        """The state after the first record, that of t = 0."""

    @abc.abstractmethod
    def update(self, state: PyTree, record: Record) -> PyTree:
        """The state after a further record."""

    @abc.abstractmethod
    def result(self, state: PyTree) -> PyTree:
        """The metric, from the last state."""

    def integrand(self, record: Record) -> PyTree:
        """Of an integral, its derivative at an instant, which a [`ContinuousExperiment`][]
        integrates beside the states; `None` of every other metric, which is a reduction of
        records there too."""
        return None

    def of_integral(self, integral: PyTree) -> PyTree:
        """The last state, from what has become of the integrand."""
        raise NotImplementedError(f"{type(self).__name__} is no integral.")


class AbstractComposed(AbstractMetric):
    """A metric that is made of the result of another."""

    @abc.abstractmethod
    def inner(self) -> AbstractMetric:
        """The metric that runs."""

    def init(self, record: Record) -> PyTree:
        return self.inner().init(record)

    def update(self, state: PyTree, record: Record) -> PyTree:
        return self.inner().update(state, record)

    def integrand(self, record: Record) -> PyTree:
        return self.inner().integrand(record)

    def of_integral(self, integral: PyTree) -> PyTree:
        return self.inner().of_integral(integral)


class PerObserver(AbstractMetric):
    """A metric of each of several observers; the result is a dictionary by observer."""

    metrics: dict[str, AbstractMetric]

    def init(self, record: Record[Any]) -> PyTree:
        return {name: m.init(record) for name, m in self.metrics.items()}

    def update(self, state: PyTree, record: Record[Any]) -> PyTree:
        return {name: m.update(state[name], record) for name, m in self.metrics.items()}

    def result(self, state: PyTree) -> PyTree:
        return {name: m.result(state[name]) for name, m in self.metrics.items()}

    def integrand(self, record: Record[Any]) -> PyTree:
        found = {name: m.integrand(record) for name, m in self.metrics.items()}
        return None if any(rate is None for rate in found.values()) else found

    def of_integral(self, integral: PyTree) -> PyTree:
        return {name: m.of_integral(integral[name]) for name, m in self.metrics.items()}


# A metric, or what makes one from the name of an observer, as most classes of metrics do.
MakeMetric = Callable[[str], AbstractMetric] | AbstractMetric


def metric_of(make: MakeMetric, observer: str) -> AbstractMetric:
    """The metric of one observer: made for its name, or like an instance; one that has no
    observer is the same for all.

    **Raises:** `ValueError` for what makes no metric."""
    if isinstance(make, AbstractMetric):
        if "observer" not in {field.name for field in dataclasses.fields(make)}:
            return make
        changes: dict[str, Any] = {"observer": observer}
        return dataclasses.replace(make, **changes)
    hint = "a metric, or a function from the name of an observer to one"
    if not callable(make):
        raise unlike("metrics", make, hint)
    name = getattr(make, "__name__", type(make).__name__)
    try:
        metric = make(observer)
    except TypeError as error:
        raise ValueError(
            "Argument `metrics` must make a metric from the name of an observer, but "
            f"`{name}({observer!r})` fails: {error}. Give what it lacks, as in `lambda "
            f"observer: {name}(observer, ...)`."
        ) from error
    if not isinstance(metric, AbstractMetric):
        raise unlike("metrics", metric, hint)
    return metric


def metric_of_each(make: MakeMetric, observers: Iterable[str]) -> AbstractMetric:
    """An instance as it is; otherwise one for each of the `observers`."""
    if isinstance(make, AbstractMetric):
        return make
    return PerObserver({name: metric_of(make, name) for name in observers})


def estimate_of(record: Record, observer: str) -> Any:
    """The estimate of an observer of the experiment."""
    if observer not in record.estimates:
        raise ValueError(
            f"Argument `observer` of a metric must be one of {sorted(record.estimates)}, "
            f"the observers of the experiment, but got {observer!r}."
        )
    return record.estimates[observer]


def error_of(record: Record, observer: str) -> Float[Array, " n"]:
    """Estimate less truth, in the units of the state."""
    return estimate_of(record, observer).value - record.hidden


def squares_of(record: Record, observer: str, norm: bool) -> Float[Array, "*n"]:
    """The squared error of each entry, or of the Euclidean norm."""
    e = error_of(record, observer)
    return jnp.sum(e * e) if norm else e * e


def counts(record: Record, after: Float[Array, ""]) -> Bool[Array, ""]:
    return record.t >= after


def size(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The magnitude, infinite where x is not a number."""
    return jnp.where(jnp.isnan(x), jnp.inf, jnp.abs(x))
