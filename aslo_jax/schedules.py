"""Schedules: rates of a low-pass filter that vary."""

from ._schedules import (
    AbstractSchedule as AbstractSchedule,
    Certified as Certified,
    FastStart as FastStart,
    Paced as Paced,
    PerSpeed as PerSpeed,
    Schedule as Schedule,
    Table as Table,
)

__all__ = [
    "AbstractSchedule",
    "Certified",
    "FastStart",
    "Paced",
    "PerSpeed",
    "Schedule",
    "Table",
]
