"""Engines: how a batch of experiments is run."""

from .batch import Batch as Batch, run_batch as run_batch
from .flatten import NotFusible as NotFusible
