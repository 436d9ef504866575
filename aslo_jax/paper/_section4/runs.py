"""Every experiment of the section, run."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from ..._simulate import Simulation
from . import loops, settings as s
from .records import record
from .tuning import CONTENDERS, Comparison, compare


class Runs(NamedTuple):
    """What the figures, the claims and the tables are made of."""

    leg: Simulation
    ball: Simulation
    constant: Simulation
    varying: Simulation
    compared: dict[str, Comparison]


def run_all(printed: s.Printed) -> Runs:
    """All experiments on the given observers, two at a time: most of it is compiling."""
    with ThreadPoolExecutor(2) as pool:
        compared = {
            name: pool.submit(_compare, mechanism())
            for name, mechanism in MECHANISMS.items()
        }
        leg, ball = pool.submit(loops.leg, printed), pool.submit(loops.ball, printed)
        constant, varying = pool.submit(loops.friction, printed).result()
        tuned = {name: each.result() for name, each in compared.items()}
        return Runs(leg.result(), ball.result(), constant, varying, tuned)


def _compare(mechanism: s.Mechanism) -> Comparison:
    return compare(mechanism, CONTENDERS, record(mechanism))


MECHANISMS = {"leg": s.leg, "ball": s.ball}
