"""Every experiment of the section, run."""

from typing import NamedTuple

from ..._simulate import Simulation
from . import experiments as s


class Runs(NamedTuple):
    """What the figures and the claims are made of."""

    printed: s.Printed
    transients: Simulation
    gains: Simulation
    noise: Simulation
    parasitics: Simulation
    scenarios: dict[str, Simulation]
    chains: dict[int, Simulation]


def run_all(printed: s.Printed) -> Runs:
    """All experiments on the given observers."""
    return Runs(
        printed,
        s.transients(printed),
        s.gains(printed),
        s.noise(printed),
        s.parasitics(printed),
        s.scenarios(printed),
        {order: s.chain(printed, order) for order in (4, 5)},
    )
