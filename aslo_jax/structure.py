"""Whether a mechanical system has an algebraic observer of its velocities, and of what
form: the assumptions of the paper's section 4.3, decided from M(q) and R(q) alone.
"""

from ._structure import (
    Friction as Friction,
    Structure as Structure,
    StructureError as StructureError,
    decay_rate as decay_rate,
    structure_of as structure_of,
)

__all__ = [
    "Friction",
    "Structure",
    "StructureError",
    "decay_rate",
    "structure_of",
]
