"""Controllers: open loop, of motors with an angle and without, bearings, mechanisms."""

from ._base import AbstractController as AbstractController, OpenLoop as OpenLoop
from ._field_oriented import (
    FieldOriented as FieldOriented,
    ForcedStart as ForcedStart,
    MotorFeedback as MotorFeedback,
    rotate as rotate,
)
from ._magnetic_levitation import (
    BearingFeedback as BearingFeedback,
    MagneticLevitation as MagneticLevitation,
)
from ._tracking import (
    BallBeamTracking as BallBeamTracking,
    MechanicalFeedback as MechanicalFeedback,
    Tracking as Tracking,
)

__all__ = [
    "AbstractController",
    "BallBeamTracking",
    "BearingFeedback",
    "FieldOriented",
    "ForcedStart",
    "MagneticLevitation",
    "MechanicalFeedback",
    "MotorFeedback",
    "OpenLoop",
    "Tracking",
    "rotate",
]
