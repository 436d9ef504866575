"""Observers of any system: the algebraic relation, derived from a model."""

from ._derive.certificate import Certificate as Certificate
from ._derive.derived import Derived as Derived, derive as derive
from ._derive.mechanical import DerivedVelocities as DerivedVelocities
from ._derive.model import Model as Model
from ._derive.observer import StateObserver as StateObserver
from ._derive.of_plant import model_of as model_of
from ._derive.refusal import NotDerivable as NotDerivable
from ._derive.relation import DerivedRelation as DerivedRelation

__all__ = [
    "Certificate",
    "Derived",
    "DerivedRelation",
    "DerivedVelocities",
    "Model",
    "NotDerivable",
    "StateObserver",
    "derive",
    "model_of",
]
