"""What is wrong with a log, told from equations of its machine that right ones satisfy."""

from typing import TYPE_CHECKING

from .._lazy import lazily as _lazily
from ._circle import Circle as Circle

if TYPE_CHECKING:
    from ._diagnose import Diagnosing as Diagnosing, diagnose as diagnose
    from ._repair import marked as marked, repaired as repaired, touched as touched
    from ._rows import Rows as Rows
    from ._timing import (
        retimed as retimed,
        retimed_pieces as retimed_pieces,
        shift_of as shift_of,
    )
    from ._value import Diagnosis as Diagnosis, Finding as Finding

__all__ = [
    "Circle",
    "Diagnosing",
    "Diagnosis",
    "Finding",
    "Rows",
    "diagnose",
    "marked",
    "repaired",
    "retimed",
    "retimed_pieces",
    "shift_of",
    "touched",
]

# A description of a machine needs a `Circle` alone.
_NAMES = {
    "_diagnose": ("Diagnosing", "diagnose"),
    "_repair": ("marked", "repaired", "touched"),
    "_rows": ("Rows",),
    "_timing": ("retimed", "retimed_pieces", "shift_of"),
    "_value": ("Diagnosis", "Finding"),
}
__getattr__, __dir__ = _lazily(__name__, _NAMES)
