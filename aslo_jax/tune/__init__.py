"""Tuning by gradients, and calibration of a machine from a log without ground truth."""

from . import losses as losses
from ._calibration import (
    Calibration as Calibration,
    Corrected as Corrected,
    Undetermined as Undetermined,
    calibrate as calibrate,
)
from ._chart import Front as Front, Surface as Surface, pareto as pareto, surface as surface
from ._descent import History as History
from ._fit import Fitted as Fitted, fit as fit
from ._stationary import stationary_variance as stationary_variance

__all__ = [
    "Calibration",
    "Corrected",
    "Fitted",
    "Front",
    "History",
    "Surface",
    "Undetermined",
    "calibrate",
    "fit",
    "losses",
    "pareto",
    "stationary_variance",
    "surface",
]
