"""Recorded logs: read from the files that a bench writes, and written.

A log has the column `t` (s), inputs, outputs, and may have truth columns for scoring; which
ones is a value, [`Signals`][]. `y[k]` is sampled at `t[k]`; `u[k]` is the mean input over
`[t[k], t[k+1])`. A log goes through one chain: a file is read, its columns are found by
name and converted to SI units, turned into the stationary frame, and looked through for
samples that are missing. One that cannot be used is refused with row, column and remedy.
"""

from ._error import LogError as LogError
from ._frame import Frame as Frame
from ._offset import Offset as Offset, offset_of as offset_of
from ._reader import Log as Log, LogReader as LogReader, read_log as read_log
from ._signals import MOTOR as MOTOR, Signals as Signals
from ._table import (
    TableWriter as TableWriter,
    check_suffix as check_suffix,
    write_table as write_table,
)

__all__ = [
    "MOTOR",
    "Frame",
    "Log",
    "LogError",
    "LogReader",
    "Signals",
    "TableWriter",
    "check_suffix",
    "read_log",
    "write_table",
]
