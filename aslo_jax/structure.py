"""Whether a mechanical system has an algebraic observer of its velocities, and of what
form: the assumptions of the paper's section 4.3, decided from M(q) and R(q) alone.
"""

from ._structure import (
    INSTEAD as INSTEAD,
    POINTS as POINTS,
    Friction as Friction,
    Region as Region,
    Structure as Structure,
    StructureError as StructureError,
    decay_rate as decay_rate,
    structure_of as structure_of,
)

__all__ = [
    "INSTEAD",
    "POINTS",
    "Friction",
    "Region",
    "Structure",
    "StructureError",
    "decay_rate",
    "structure_of",
]
