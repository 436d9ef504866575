"""`kind = "double_integrator"`: a mass under a known force, for studies alone."""

from typing import Any, Literal

import jax.numpy as jnp

from ..observers import AbstractObserver, ReducedLuenberger, SteadyStateKalman
from ..plants import IntegratorChain
from ..schema import Table, key
from . import offers
from ._study import Study


class DoubleIntegratorTable(Table):
    """`x1' = x2, x2' = u, y = x1`."""

    kind: Literal["double_integrator"] = key("the kind of machine")


class ChainStart(Table):
    """The state in which it starts."""

    position: float = key("position at the start", "m", default=0.0)
    speed: float = key("speed at the start", "m/s", default=0.0)


def _luenberger(keys: Any, plant: Any, start: Any) -> AbstractObserver:
    del plant, start
    return ReducedLuenberger.of_chain(2, keys.gain)


def _kalman(keys: Any, plant: Any, start: Any) -> AbstractObserver:
    del plant, start
    offers.refuse_keys(keys, "voltage", "drift")
    offers.one_number(keys, "process", "measurement")
    A, B, C = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]]
    process = jnp.asarray(keys.process, float)
    return SteadyStateKalman.design(A, B, C, float(process), keys.measurement, [[0.0, 1.0]])


def _relations(plant: IntegratorChain) -> tuple[Any]:
    return (plant.relation(),)


STUDY = Study(
    machine=DoubleIntegratorTable,
    acting=ChainStart,
    entries=("speed",),
    units=("m/s",),
    plant=lambda table: IntegratorChain(2),
    start=lambda plant, table: jnp.array([table.position, table.speed], float),
    observers=offers.algebraic(_relations)
    | offers.integrator(_relations)
    | offers.lifted(_relations)
    | {"luenberger": _luenberger, "kalman": _kalman},
    controls=("open_loop",),
    bound=True,
)
