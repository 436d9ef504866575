"""What can be smoothed: which machines, and how long a log."""

from ..logs import LogReader
from ..machines import AbstractDescription, MachineError
from ..machines._lifted import LIFTED, kind_of

MOST = 1_000_000  # rows: about a gigabyte of beliefs


def check_smoothing(machine: AbstractDescription, path: str, missing: str) -> None:
    """Refuse a machine whose observer is not smoothed.

    **Raises:** [`MachineError`][], `ValueError`.
    """
    if kind_of(machine.observer) != LIFTED:
        raise MachineError(
            f'--smooth is for an `observer.kind` of "{LIFTED}", which {path} has not: '
            "no other observer is smoothed."
        )
    if machine.kind == "magnetic_bearing":
        raise MachineError(
            f'--smooth is not for {path}, whose kind is "magnetic_bearing": the velocity '
            "comes from a filter, which does not look ahead."
        )
    if missing == "coast":
        raise ValueError(
            "--smooth and --missing coast do not go together: samples that are missing are "
            "not smoothed over; use --missing interpolate."
        )


def check_length(reader: LogReader) -> None:
    """Refuse a log whose beliefs do not fit in memory.

    **Raises:** `ValueError`.
    """
    if reader.t.size > MOST:
        raise ValueError(
            f"--smooth takes at most {MOST} rows, which are held in memory, but "
            f"{reader.name} has {reader.t.size}; cut it into parts."
        )
