"""Parameters of a machine from a log without ground truth, by its relation's residual."""

from .corrected import Corrected as Corrected
from .method import calibrate as calibrate
from .result import Calibration as Calibration, Undetermined as Undetermined

__all__ = ["Calibration", "Corrected", "Undetermined", "calibrate"]
