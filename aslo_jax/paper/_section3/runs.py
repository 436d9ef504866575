"""Every experiment of the section, run."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..._simulate import Simulation
from . import machines, pmsm
from .settings import Printed


class Runs(NamedTuple):
    """What the figures, the claims and the table are made of."""

    printed: Printed
    closed: Simulation
    steady: Simulation
    reversal: pmsm.Reversal
    growth: np.ndarray
    shorted: Simulation
    modulation: Simulation
    salient: machines.Salient
    bearing: Simulation
    stepper: Simulation


def run_all(printed: Printed) -> Runs:
    """All experiments on the given observers, two at a time: most of it is compiling."""
    with ThreadPoolExecutor(2) as pool:
        given = {
            "closed": (pmsm.closed_loop, pmsm.observers(printed)),
            "shorted": (machines.shorted_rotor, printed),
            "reversal": (pmsm.reversal, printed),
            "bearing": (machines.bearing,),
            "steady": (pmsm.steady, printed),
            "modulation": (machines.modulation, printed),
            "salient": (machines.salient,),
            "stepper": (machines.stepper, printed),
            "growth": (pmsm.fo1_growth, printed),
        }
        runs = {name: pool.submit(*call) for name, call in given.items()}
        return Runs(printed, **{name: run.result() for name, run in runs.items()})
