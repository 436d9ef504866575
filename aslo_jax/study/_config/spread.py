"""`[spread.NAME]` of a study."""

import abc
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ...schema import Positive, Table, key, unit_of
from .._distributions import (
    AbstractDistribution,
    Correlated,
    Discrete,
    LogNormal,
    Normal,
    Uniform,
)
from .._spread import Parameter, Spread, names_of

WHERE = "path of what it sets, for instance plant.resistance"


class AbstractSpreadTable(Table, abc.ABC):
    """A parameter that varies."""

    where: Any
    distribution: Any
    relative: bool = key("whether it multiplies what the experiment has", default=False)

    @abc.abstractmethod
    def law(self) -> AbstractDistribution:
        """Its distribution."""


class NormalTable(AbstractSpreadTable):
    """A normal distribution."""

    where: str = key(WHERE)
    distribution: Literal["normal"] = key("the distribution")
    mean: float = key("mean")
    deviation: Positive = key("standard deviation")
    low: float | None = key("nothing below is drawn", default=None)
    high: float | None = key("nothing above is drawn", default=None)

    def law(self) -> AbstractDistribution:
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return Normal(self.mean, self.deviation, low, high)


class UniformTable(AbstractSpreadTable):
    """A uniform distribution."""

    where: str = key(WHERE)
    distribution: Literal["uniform"] = key("the distribution")
    low: float = key("the least value")
    high: float = key("the largest value")

    def law(self) -> AbstractDistribution:
        return Uniform(self.low, self.high)


class LogNormalTable(AbstractSpreadTable):
    """A log-normal distribution."""

    where: str = key(WHERE)
    distribution: Literal["log-normal"] = key("the distribution")
    median: Positive = key("median")
    deviation: Positive = key("standard deviation of the logarithm")

    def law(self) -> AbstractDistribution:
        return LogNormal(self.median, self.deviation)


class DiscreteTable(AbstractSpreadTable):
    """A discrete distribution."""

    where: str = key(WHERE)
    distribution: Literal["discrete"] = key("the distribution")
    values: list[float] = key("the values")
    weights: list[float] | None = key("their weights, by default equal", default=None)

    def law(self) -> AbstractDistribution:
        weights = None if self.weights is None else tuple(self.weights)
        return Discrete(tuple(self.values), weights)


class CorrelatedTable(AbstractSpreadTable):
    """A joint normal distribution."""

    where: list[str] = key("paths of what it sets, one for each number")
    distribution: Literal["correlated"] = key("the distribution")
    mean: list[float] = key("means")
    deviation: list[Positive] = key("standard deviations")
    correlation: list[list[float]] = key("matrix of correlations")
    names: list[str] | None = key("of the numbers, by default counted", default=None)

    def law(self) -> AbstractDistribution:
        return Correlated.of(self.mean, self.deviation, self.correlation)


SpreadItem = Annotated[
    NormalTable | UniformTable | LogNormalTable | DiscreteTable | CorrelatedTable,
    Field(discriminator="distribution"),
]


def parameter(table: AbstractSpreadTable) -> Parameter:
    """The parameter of a table."""
    names = getattr(table, "names", None)
    return Parameter(
        table.where, table.law(), table.relative, None if names is None else tuple(names)
    )


def parameter_units(
    tables: Mapping[str, AbstractSpreadTable],
    machine: type[Table],
    known: Mapping[str, str],
) -> dict[str, str]:
    """The units of the numbers drawn, by their variables, where they are factors, keys of
    the `[machine]`, or `known` by their path."""
    found = {}
    for name, table in tables.items():
        wheres = [table.where] if isinstance(table.where, str) else table.where
        for each, where in zip(
            names_of(Spread({name: parameter(table)})), wheres, strict=True
        ):
            unit = known.get(where) or _unit(where, machine)
            found[f"parameter_{each}"] = "1" if table.relative else unit
    return {name: unit for name, unit in found.items() if unit}


def _unit(where: str, machine: type[Table]) -> str:
    room, _, rest = where.partition(".")
    field = machine.model_fields.get(rest.split(".")[0])
    return unit_of(field) if room == "plant" and field is not None else ""
