"""What is wrong with a log, told from equations of its machine that right ones satisfy."""

from typing import TYPE_CHECKING

from .._lazy import lazily as _lazily
from .circle import Circle as Circle

if TYPE_CHECKING:
    from .diagnose import Diagnosing as Diagnosing, diagnose as diagnose
    from .repair import marked as marked, repaired as repaired, touched as touched
    from .rows import Rows as Rows
    from .timing import (
        retimed as retimed,
        retimed_pieces as retimed_pieces,
        shift_of as shift_of,
    )
    from .value import Diagnosis as Diagnosis, Finding as Finding

# A description of a machine needs a `Circle` alone.
_NAMES = {
    "diagnose": ("Diagnosing", "diagnose"),
    "repair": ("marked", "repaired", "touched"),
    "rows": ("Rows",),
    "timing": ("retimed", "retimed_pieces", "shift_of"),
    "value": ("Diagnosis", "Finding"),
}
__getattr__, __dir__ = _lazily(__name__, _NAMES)
