"""Tuning by gradients, and calibration of a machine from a log without ground truth."""

from . import losses as losses
from .calibration import (
    Calibration as Calibration,
    Corrected as Corrected,
    Undetermined as Undetermined,
    calibrate as calibrate,
)
from .chart import (
    Front as Front,
    Surface as Surface,
    pareto as pareto,
    surface as surface,
)
from .descent import History as History
from .fit import Fitted as Fitted, fit as fit
from .stationary import stationary_variance as stationary_variance

__all__ = [
    "Calibration",
    "Corrected",
    "Fitted",
    "Front",
    "History",
    "Surface",
    "Undetermined",
    "calibrate",
    "design_chart",
    "fit",
    "front_chart",
    "losses",
    "pareto",
    "plot_history",
    "stationary_variance",
    "surface",
]
