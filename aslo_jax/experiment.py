"""The sampled closed loop: hold, integrate, measure, observe, control."""

from ._experiment import Experiment as Experiment, Record as Record

__all__ = [
    "Experiment",
    "Record",
]
