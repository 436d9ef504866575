"""What can be smoothed: which machines, and how long a log."""

import numpy as np

from ..logs import LogReader
from ..machines import AbstractDescription, MachineError
from ..machines._lifted import ADAPTIVE, LIFTED, is_adaptive, is_lifted
from ..machines._mechanism import AbstractMechanism

MOST = 1_000_000  # rows: about a gigabyte of beliefs


def check_smoothing(machine: AbstractDescription, path: str) -> None:
    """Refuse a machine whose observer is not smoothed.

    **Raises:** [`MachineError`][].
    """
    if not is_lifted(machine.observer):
        raise MachineError(
            f'--smooth is for an `observer.kind` of "{LIFTED}" or "{ADAPTIVE}", which '
            f"{path} has not: no other observer is smoothed."
        )
    if isinstance(machine, AbstractMechanism):
        raise MachineError(
            f'--smooth is not for {path}, whose kind is "{machine.kind}": what is smoothed '
            "is the Kalman filter of a relation, and this is one of all velocities of a "
            "mechanism, linear about each estimate; do not smooth."
        )
    if is_adaptive(machine.observer) and np.any(np.asarray(machine.observer.drift)):
        raise MachineError(
            f"--smooth is for parameters that are constant, but {path} has an "
            "`observer.drift`: remove it, or do not smooth."
        )
    if machine.kind == "magnetic_bearing":
        raise MachineError(
            f'--smooth is not for {path}, whose kind is "magnetic_bearing": the velocity '
            "comes from a filter, which does not look ahead."
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
