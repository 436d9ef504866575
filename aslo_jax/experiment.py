"""The sampled closed loop: hold, integrate, measure, observe, control."""

from ._continuous import ContinuousExperiment as ContinuousExperiment
from ._experiment import Experiment as Experiment, Record as Record

__all__ = [
    "ContinuousExperiment",
    "Experiment",
    "Record",
]
