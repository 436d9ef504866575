"""Controllers: open loop, and field-oriented control with and without an angle."""

from .base import AbstractController as AbstractController, OpenLoop as OpenLoop
from .field_oriented import (
    FieldOriented as FieldOriented,
    ForcedStart as ForcedStart,
    MotorFeedback as MotorFeedback,
    rotate as rotate,
)
