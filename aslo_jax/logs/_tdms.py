"""TDMS files of LabVIEW, by npTDMS: every channel is a column called `group/channel`."""

from pathlib import Path

import numpy as np

from .._extras import require
from ._error import LogError
from ._source import Source, of_arrays


def read_tdms(path: Path) -> Source:
    """The channels of a TDMS file, in memory; where waveforms say their start and interval,
    these are the column `t` (s)."""
    tdms = require("nptdms", "tdms")
    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, tuple[float, float, int]] = {}
    try:
        # A file that it cannot read it leaves open.
        with path.open("rb") as raw, tdms.TdmsFile.open(raw) as file:
            for group in file.groups():
                for channel in group.channels():
                    name = f"{group.name}/{channel.name}"
                    arrays[name] = np.asarray(channel[:])
                    if unit := str(channel.properties.get("unit_string", "")):
                        units[name] = unit
                    step = channel.properties.get("wf_increment", 0.0)
                    if step:
                        start = float(channel.properties.get("wf_start_offset", 0.0))
                        clocks[name] = (start, float(step), len(channel))
    except OSError:
        raise
    except Exception as error:  # struct, ValueError and npTDMS's own
        raise LogError(f"{path} is not a readable TDMS file: {error}") from error
    of_column: dict[str, str] = {}
    for name, clock in clocks.items():
        one = len(set(clocks.values())) == 1
        own = "t" if one else f"{name}.t"
        start, step, size = clock
        arrays[own] = start + step * np.arange(size)
        of_column |= {name: own, own: own}
    return of_arrays(path, arrays, units=units, clocks=of_column)
