"""One set of equations, realised as a start, a vector field, or a sampled recurrence."""

from ._realise import (
    AbstractRealisation as AbstractRealisation,
    Advance as Advance,
    Drive as Drive,
    Flow as Flow,
    Pass as Pass,
    Start as Start,
    States as States,
)

__all__ = [
    "AbstractRealisation",
    "Advance",
    "Drive",
    "Flow",
    "Pass",
    "Start",
    "States",
]
