"""Metrics of an experiment, computed sample by sample as it runs."""

from ._angles import (
    AngleError as AngleError,
    FluxAngle as FluxAngle,
    PeakAngleError as PeakAngleError,
    RotorAngle as RotorAngle,
)
from ._base import AbstractMetric as AbstractMetric
from ._coasting import CoastingFraction as CoastingFraction
from ._diverged import Diverged as Diverged
from ._errors import (
    FinalError as FinalError,
    IntegralSquaredError as IntegralSquaredError,
    MeanError as MeanError,
    PeakError as PeakError,
    RMSError as RMSError,
)
from ._functions import (
    Final as Final,
    Integral as Integral,
    Maximum as Maximum,
    Mean as Mean,
)
from ._settling import SettlingTime as SettlingTime

__all__ = [
    "AbstractMetric",
    "AngleError",
    "CoastingFraction",
    "Diverged",
    "Final",
    "FinalError",
    "FluxAngle",
    "Integral",
    "IntegralSquaredError",
    "Maximum",
    "Mean",
    "MeanError",
    "PeakAngleError",
    "PeakError",
    "RMSError",
    "RotorAngle",
    "SettlingTime",
]
