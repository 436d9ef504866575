"""Engines: how a batch of experiments is run."""

from .batch import Batch as Batch, Runner as Runner, run_batch as run_batch
from .frontend.lower import NotFusible as NotFusible

__all__ = ["Batch", "NotFusible", "Runner", "run_batch"]
