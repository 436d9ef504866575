"""What is wrong with a log, told from equations of its machine that right ones satisfy."""

from typing import TYPE_CHECKING

from .._lazy import lazily as _lazily
from ._circle import Circle as Circle

if TYPE_CHECKING:
    from ._absent import absent_rows as absent_rows, bridged as bridged
    from ._diagnose import Diagnosing as Diagnosing, diagnose as diagnose
    from ._motion import Motion as Motion
    from ._repair import marked as marked, repaired as repaired, touched as touched
    from ._rotations import FRAMES as FRAMES
    from ._rows import Rows as Rows
    from ._stamps import of_stamps as of_stamps
    from ._timing import (
        retimed as retimed,
        retimed_pieces as retimed_pieces,
        shift_of as shift_of,
    )
    from ._truth import Truth as Truth
    from ._value import Diagnosis as Diagnosis, Finding as Finding

__all__ = [
    "FRAMES",
    "Circle",
    "Diagnosing",
    "Diagnosis",
    "Finding",
    "Motion",
    "Rows",
    "Truth",
    "absent_rows",
    "bridged",
    "diagnose",
    "marked",
    "of_stamps",
    "repaired",
    "retimed",
    "retimed_pieces",
    "shift_of",
    "touched",
]

# A description of a machine needs a `Circle` alone.
_NAMES = {
    "_absent": ("absent_rows", "bridged"),
    "_diagnose": ("Diagnosing", "diagnose"),
    "_motion": ("Motion",),
    "_repair": ("marked", "repaired", "touched"),
    "_rotations": ("FRAMES",),
    "_rows": ("Rows",),
    "_stamps": ("of_stamps",),
    "_timing": ("retimed", "retimed_pieces", "shift_of"),
    "_truth": ("Truth",),
    "_value": ("Diagnosis", "Finding"),
}
__getattr__, __dir__ = _lazily(__name__, _NAMES)
