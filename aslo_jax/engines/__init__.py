"""Engines: how a batch of experiments is run."""

from ._batch import Batch as Batch, Runner as Runner, run_batch as run_batch
from ._frontend.lower import NotFusible as NotFusible

__all__ = ["Batch", "NotFusible", "Runner", "run_batch"]
