"""Losses over a Monte-Carlo batch of experiments, a recorded log, a linear observer."""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import random
from .._checks import nonnegative, positive, real, whole
from .._experiment import Experiment, Record
from .._module import Module
from .._replay import replay
from .._typing import Engine, PyTree, RealArray
from ..engines import run_batch
from ..engines._fused.plan import Plan
from ..metrics import AbstractMetric
from ..metrics._base import MakeMetric, metric_of
from ..observers import AbstractObserver
from ._checkpoints import checkpointed

__all__ = [
    "AbstractLoss",
    "CVaR",
    "MeanSquare",
    "MonteCarlo",
    "NoiseAndTransient",
    "Recorded",
    "Reduction",
    "SmoothSettling",
    "TransientAndNoise",
    "mean",
    "worst",
]

Reduction = Callable[[Float[Array, "N *costs"]], Float[Array, "*costs"]]


class AbstractLoss(Module):
    """`loss(tree, key)`, to be minimised over leaves of the tree: the same key, the same
    random numbers."""

    @property
    @abc.abstractmethod
    def most_forward(self) -> int:
        """The number of parameters up to which forward derivatives are the cheaper ones."""

    @abc.abstractmethod
    def __call__(self, tree: PyTree, key: random.Key) -> Float[Array, ""]:
        """The loss of a tree."""

    @abc.abstractmethod
    def reversible(self) -> "AbstractLoss":
        """The same loss, computed so that it has reverse derivatives."""


# ---- reductions over the samples of a batch ------------------------------------------


def mean(costs: Float[Array, "N *costs"]) -> Float[Array, "*costs"]:
    """The mean over the batch of the `costs`, shape `(N, ...)`: of one cost or several."""
    return jnp.mean(costs, axis=0)


def worst(costs: Float[Array, " N"]) -> Float[Array, ""]:
    """The worst sample of the `costs`, shape `(N,)`. Its gradient is that of one sample; a
    [`CVaR`][] has a smoother one.
    """
    return jnp.max(costs)


class CVaR(Module):
    """The conditional value at risk: the mean of the worst `fraction` of the samples, the
    last of them counted in part.

    Source: Rockafellar and Uryasev 2000, doi:10.21314/JOR.2000.038.

    **Raises:** `ValueError` for a `fraction` out of (0, 1].
    """

    fraction: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not 0.0 < self.fraction <= 1.0:
            raise ValueError(
                f"Argument `fraction` must be in (0, 1], but got {self.fraction}."
            )

    def __call__(self, costs: Float[Array, " N"]) -> Float[Array, ""]:
        """Of the costs of all samples."""
        count = self.fraction * costs.shape[0]
        weights = jnp.clip(count - jnp.arange(costs.shape[0]), 0.0, 1.0)
        return jnp.sum(weights * jnp.sort(costs, descending=True)) / count


# ---- costs of one experiment ---------------------------------------------------------


def _square(record: Record, observer: str, scale: Array) -> Float[Array, ""]:
    e = (record.estimates[observer].value - record.hidden) / scale
    return jnp.sum(e * e)


class MeanSquare(AbstractMetric):
    """The mean over time of the squared Euclidean norm of the error of `observer`, from
    `after` (s) on, each entry in units of `scale`, shape `()` or `(n,)`."""

    observer: str = eqx.field(static=True)
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    scale: Float[Array, "*n"] = eqx.field(converter=real, default=1.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)
        positive("scale", self.scale)

    def init(self, record: Record) -> PyTree:
        counts = jnp.where(record.t >= self.after, 1.0, 0.0)
        return counts, counts * _square(record, self.observer, self.scale)

    def update(self, state: PyTree, record: Record) -> PyTree:
        more = self.init(record)
        return state[0] + more[0], state[1] + more[1]

    def result(self, state: PyTree) -> PyTree:
        return state[1] / jnp.maximum(state[0], 1.0)


class NoiseAndTransient(AbstractMetric):
    """The mean square error of `observer` from `split` (s) on, which is noise, and `weight`
    (1/s) times the integral of the squared error up to there, which is transient.

    `scale`, shape `()` or `(n,)`, as in [`MeanSquare`][]; `interval`: between samples (s).
    """

    observer: str = eqx.field(static=True)
    split: Float[Array, ""] = eqx.field(converter=real)
    interval: Float[Array, ""] = eqx.field(converter=real)
    weight: Float[Array, ""] = eqx.field(converter=real, default=1.0)
    scale: Float[Array, "*n"] = eqx.field(converter=real, default=1.0)

    def __check_init__(self) -> None:
        positive("split", self.split, "s")
        positive("interval", self.interval, "s")
        nonnegative("weight", self.weight)
        positive("scale", self.scale)

    def init(self, record: Record) -> PyTree:
        late = jnp.where(record.t >= self.split, 1.0, 0.0)
        square = _square(record, self.observer, self.scale)
        return late, late * square, (1.0 - late) * square

    def update(self, state: PyTree, record: Record) -> PyTree:
        return tuple(a + b for a, b in zip(state, self.init(record), strict=True))

    def parts(self, state) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The noise (mean square) and the transient (integral of the square, s)."""
        count, noise, transient = state
        return noise / jnp.maximum(count, 1.0), self.interval * transient

    def result(self, state: PyTree) -> PyTree:
        noise, transient = self.parts(state)
        return noise + self.weight * transient


class TransientAndNoise(AbstractMetric):
    """The two parts of a [`NoiseAndTransient`][] (without its weight), shape `(2,)`: the
    transient, the integral of the squared error up to `split` (s), and the noise, the mean
    square from there on. For a Pareto front.

    `observer`, `interval` (s) and `scale`, shape `()` or `(n,)`, as there.
    """

    observer: str = eqx.field(static=True)
    split: Float[Array, ""] = eqx.field(converter=real)
    interval: Float[Array, ""] = eqx.field(converter=real)
    scale: Float[Array, "*n"] = eqx.field(converter=real, default=1.0)

    def _weighted(self) -> NoiseAndTransient:
        return NoiseAndTransient(self.observer, self.split, self.interval, scale=self.scale)

    def init(self, record: Record) -> PyTree:
        return self._weighted().init(record)

    def update(self, state: PyTree, record: Record) -> PyTree:
        return self._weighted().update(state, record)

    def result(self, state: PyTree) -> PyTree:
        noise, transient = self._weighted().parts(state)
        return jnp.stack([transient, noise])


class SmoothSettling(AbstractMetric):
    """How long (s) the error of `observer` is outside `tolerance`, in Euclidean norm and
    the units of the estimate: a settling time with a derivative.

    Within a factor of `exp(width)` of the tolerance an instant counts in part, by the
    logistic function of `log(|e|/tolerance)/width`. For an error that falls and stays, it
    is the settling time as the width goes to zero; one that leaves again counts its time
    outside only. `interval`: between samples (s).
    """

    observer: str = eqx.field(static=True)
    tolerance: Float[Array, ""] = eqx.field(converter=real)
    interval: Float[Array, ""] = eqx.field(converter=real)
    width: Float[Array, ""] = eqx.field(converter=real, default=0.2)

    def __check_init__(self) -> None:
        positive("tolerance", self.tolerance)
        positive("interval", self.interval, "s")
        positive("width", self.width)

    def init(self, record: Record) -> PyTree:
        # (|e|/tolerance)^(1/width) over one more than that, without a logarithm of zero.
        ratio = _square(record, self.observer, self.tolerance)
        tiny = jnp.finfo(ratio.dtype).tiny
        outside = jnp.log(ratio + tiny) / (2.0 * self.width)
        return self.interval / (1.0 + jnp.exp(-outside))

    def update(self, state: PyTree, record: Record) -> PyTree:
        return state + self.init(record)

    def result(self, state: PyTree) -> PyTree:
        return state


# ---- losses --------------------------------------------------------------------------


def _itself(key: random.Key) -> random.Key:
    return key


class MonteCarlo(AbstractLoss):
    """A metric of many experiments, reduced to one number.

    - `place(tree, sample)`: the experiment of one sample; the tree is that given to
      [`fit`][], an experiment, say, or a dictionary of gains;
    - `metric`: a scalar of one experiment, as [`MeanSquare`][]: an instance, or a class or
      any `metric(observer)` where the experiment has one observer;
    - `samples`: how many; `steps`: the intervals of each;
    - `draw(key)`: one sample from its key, by default the key itself;
    - `reduce`: [`mean`][], [`worst`][], a [`CVaR`][], or any function of the costs of all
      samples, shape `(N,)`;
    - `engine`, `threads`: as in [`aslo_jax.run_batch`][].

    Sample k has the key `fold(key, k)`, so fits with the same key see the same samples.

    **Raises:** `ValueError` for a `metric` without an observer's name where an experiment
    has several.
    """

    place: Callable[[PyTree, PyTree], Experiment[Any]]
    metric: MakeMetric
    samples: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    draw: Callable[[random.Key], PyTree] = _itself
    reduce: Reduction = mean
    engine: Engine = eqx.field(static=True, default="auto")
    threads: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        whole("samples", self.samples)
        whole("steps", self.steps)

    def __call__(self, tree: PyTree, key: random.Key) -> RealArray:
        return self.reduce(self.costs(tree, key))

    @property
    def most_forward(self) -> int:
        # A scan, which is what reverse derivatives need, takes as long as the tangents of
        # some hundred directions in the fused engine.
        return 256

    def costs(self, tree: PyTree, key: random.Key) -> Float[Array, "N *costs"]:
        """The metric of every sample."""
        keys = jax.vmap(random.fold, (None, 0))(key, jnp.arange(self.samples))
        drawn = jax.vmap(self.draw)(keys)
        # What is traced goes through the samples, where derivatives are taken; what is
        # known stays a constant of the compiled loop.
        traced, known = eqx.partition(tree, lambda x: isinstance(x, jax.core.Tracer))
        shared = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (self.samples, *x.shape)), traced
        )

        def make(sample):
            return self.place(eqx.combine(sample[0], known), sample[1])

        metrics, samples = {"cost": self._metric(tree, key)}, (shared, drawn)
        if self.engine == "checkpointed":
            plan = Plan(make, metrics, None)
            return checkpointed(plan, samples, self.steps)["cost"]
        batch = run_batch(
            make,
            samples,
            self.steps,
            metrics=metrics,
            engine=self.engine,
            threads=self.threads,
        )
        return batch.metrics["cost"]

    def _metric(self, tree: PyTree, key: random.Key) -> AbstractMetric:
        if isinstance(self.metric, AbstractMetric):
            return self.metric
        one = lambda tree, key: self.place(tree, self.draw(key))
        observers = list(eqx.filter_eval_shape(one, tree, key).observers)
        if len(observers) != 1:
            raise ValueError(
                "Argument `metric` must be an instance that names its observer where an "
                f"experiment has several, but this one has {observers}."
            )
        return metric_of(self.metric, observers[0])

    def reversible(self) -> "AbstractLoss":
        return dataclasses.replace(self, engine="checkpointed")


class Recorded(AbstractLoss):
    """The mean square error of an observer over a log with the true state, from `after` (s)
    on: `t`, shape `(N,)`; `u` and `y` as in [`aslo_jax.replay`][]; `truth`, shape `(N, n)`;
    `scale`, shape `()` or `(n,)`, the unit of the errors; `substeps`, as in
    [`aslo_jax.replay`][], a whole number from 1. The tree is the observer, or what
    `place(tree)` makes it of.
    """

    t: Any
    u: PyTree
    y: PyTree
    truth: Float[Array, "N n"] = eqx.field(converter=real)
    after: float = eqx.field(static=True, default=0.0)
    scale: Float[Array, "*n"] = eqx.field(converter=real, default=1.0)
    substeps: int = eqx.field(static=True, default=1)
    place: Callable[[PyTree], AbstractObserver] = lambda observer: observer

    def __check_init__(self) -> None:
        positive("scale", self.scale)

    def __call__(self, tree: PyTree, key: random.Key) -> RealArray:
        del key
        observer = self.place(tree)
        value = replay(observer, self.t, self.u, self.y, substeps=self.substeps).value
        error = (value - self.truth) / self.scale
        counts = jnp.asarray(self.t) - self.t[0] >= self.after
        square = jnp.where(counts, jnp.sum(error * error, axis=1), 0.0)
        return jnp.sum(square) / jnp.maximum(jnp.sum(counts), 1)

    @property
    def most_forward(self) -> int:
        return 16

    def reversible(self) -> "AbstractLoss":
        return self
