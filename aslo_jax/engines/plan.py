"""What a batch runs, for one sample."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jaxtyping import PyTree

from ..experiment import Experiment, Record
from ..metrics import AbstractMetric


class Batch(eqx.Module):
    """The results of `N` experiments, every leaf with a leading axis of length N.

    - `metrics`: by name;
    - `record`: what was asked to be recorded, with a second axis of `steps // every + 1`
      samples, the first at t = 0; `None` where nothing was.
    """

    metrics: dict[str, PyTree]
    record: PyTree


class Plan(eqx.Module):
    """The loop of one sample: its state is the experiment's carry and that of the metrics,
    its output what is kept of a record and the metrics up to now."""

    make: Callable[[PyTree], Experiment]
    metrics: dict[str, AbstractMetric]
    record: Callable[[Record], PyTree] | None

    def first(self, sample: PyTree) -> tuple[PyTree, PyTree]:
        carry, record = self.make(sample).init()
        return self._out(
            carry, {n: m.init(record) for n, m in self.metrics.items()}, record
        )

    def prepared(self, sample: PyTree) -> PyTree:
        """What depends on the sample only."""
        experiment = self.make(sample)
        carry, _ = experiment.init()
        return experiment.prepare(carry)

    def step(
        self, k: Any, state: PyTree, sample: PyTree, prepared: PyTree
    ) -> tuple[PyTree, PyTree]:
        carry, metrics = state
        carry, record = self.make(sample).advance(k, carry, prepared)
        metrics = {n: m.update(metrics[n], record) for n, m in self.metrics.items()}
        return self._out(carry, metrics, record)

    def _out(self, carry: PyTree, metrics: PyTree, record: Record) -> tuple[PyTree, PyTree]:
        kept = None if self.record is None else self.record(record)
        results = {name: m.result(metrics[name]) for name, m in self.metrics.items()}
        return (carry, metrics), (kept, results)


def joined(first: PyTree, rest: PyTree, axis: int, xp: Any) -> PyTree:
    """The first sample and the rest, along the axis of the samples."""
    join = lambda a, b: xp.concatenate([xp.expand_dims(a, axis), b], axis)
    return jax.tree.map(join, first, rest)
