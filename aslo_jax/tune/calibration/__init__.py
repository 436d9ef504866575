"""Parameters of a machine from a log without ground truth, by its relation's residual."""

from .corrected import Corrected as Corrected
from .result import Calibration as Calibration, Undetermined as Undetermined
from .search import calibrate as calibrate

__all__ = ["Calibration", "Corrected", "Undetermined", "calibrate"]
