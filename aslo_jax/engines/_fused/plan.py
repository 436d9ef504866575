"""What a batch runs, for one sample."""

from collections.abc import Callable
from typing import Any

from ..._experiment import Record
from ..._module import Module
from ..._typing import PyTree
from ...metrics import AbstractMetric


class Batch(Module):
    """The results of `N` experiments, every leaf with a leading axis of length N.

    - `metrics`: by name, and then by observer where a metric was asked for of each;
    - `record`: what was asked to be recorded, with a second axis of `steps // every + 1`
      samples, the first at t = 0; `None` where nothing was.
    """

    metrics: dict[str, PyTree]
    record: PyTree


class Plan(Module):
    """The loop of one sample: its state is the experiment's carry and that of the metrics,
    its output what is kept of a record."""

    make: Callable[[PyTree], Any]
    metrics: dict[str, AbstractMetric]
    record: Callable[[Record[Any]], PyTree] | None

    def first(self, sample: PyTree) -> tuple[PyTree, PyTree]:
        state, kept, _ = self.begun(sample)
        return state, kept

    def prepared(self, sample: PyTree) -> PyTree:
        """What depends on the sample only."""
        *_, prepared = self.begun(sample)
        return prepared

    def begun(self, sample: PyTree) -> tuple[PyTree, PyTree, PyTree]:
        """The first state, what is kept of its record, and what depends on the sample
        only, by one start of the experiment."""
        experiment = self.make(sample)
        carry, record = experiment.init()
        metrics = {name: m.init(record) for name, m in self.metrics.items()}
        return (carry, metrics), self._kept(record), experiment.prepare(carry)

    def step(
        self, k: Any, state: PyTree, sample: PyTree, prepared: PyTree
    ) -> tuple[PyTree, PyTree]:
        carry, metrics = state
        carry, record = self.make(sample).advance(k, carry, prepared)
        metrics = {n: m.update(metrics[n], record) for n, m in self.metrics.items()}
        return (carry, metrics), self._kept(record)

    def results(self, state: PyTree) -> dict[str, PyTree]:
        """The metrics, from the last state."""
        _, metrics = state
        return {name: m.result(metrics[name]) for name, m in self.metrics.items()}

    def _kept(self, record: Record[Any]) -> PyTree:
        return None if self.record is None else self.record(record)
