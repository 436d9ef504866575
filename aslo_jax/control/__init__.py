"""Controllers: open loop, of motors with an angle and without, bearings, mechanisms, and
of what does not stay where it is."""

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
from ._recorded import RecordedInput as RecordedInput
from ._reluctance_drive import ReluctanceDrive as ReluctanceDrive
from ._state_feedback import StateFeedback as StateFeedback
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
    "RecordedInput",
    "ReluctanceDrive",
    "StateFeedback",
    "Tracking",
    "rotate",
]
