"""One set of equations, realised as a start, a vector field, or a sampled recurrence."""

from ._realise import (
    AbstractRealisation as AbstractRealisation,
    Advance as Advance,
    Flow as Flow,
    Pass as Pass,
    Start as Start,
)

__all__ = [
    "AbstractRealisation",
    "Advance",
    "Flow",
    "Pass",
    "Start",
]
