"""The guard: coasting on the known derivative while the state is not observable."""

from ._guard import Guard as Guard, Memory as Memory

__all__ = [
    "Guard",
    "Memory",
]
