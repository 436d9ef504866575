"""Engines: how a batch of experiments is run."""

from typing import TYPE_CHECKING

from .._lazy import lazily as _lazily

if TYPE_CHECKING:
    from .._frontend.lower import NotFusible as NotFusible
    from ._batch import Batch as Batch, Runner as Runner, run_batch as run_batch

__all__ = ["Batch", "NotFusible", "Runner", "run_batch"]

# Lazily, for a replay needs the engine without experiments and what these import.
__getattr__, __dir__ = _lazily(
    __name__,
    {"_batch": ("Batch", "Runner", "run_batch"), "._frontend.lower": ("NotFusible",)},
)
