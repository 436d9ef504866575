"""The sampled closed loop: hold, integrate, measure, observe, control."""

from ._experiment import Carry as Carry, Experiment as Experiment, Record as Record

__all__ = [
    "Carry",
    "Experiment",
    "Record",
]
