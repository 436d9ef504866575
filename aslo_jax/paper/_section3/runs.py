"""Every experiment of the section, run."""

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
    """All experiments on the given observers."""
    return Runs(
        printed,
        pmsm.closed_loop(pmsm.observers(printed)),
        pmsm.steady(printed),
        pmsm.reversal(printed),
        pmsm.fo1_growth(printed),
        machines.shorted_rotor(printed),
        machines.modulation(printed),
        machines.salient(),
        machines.bearing(),
        machines.stepper(printed),
    )
