"""`[metrics.NAME]` of a study."""

import abc
import functools
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ... import metrics
from ...metrics._base import MakeMetric
from ...schema import NonNegative, Positive, Table, key


class AbstractMetricTable(Table, abc.ABC):
    """A metric; `general`: whether it is for any machine, and not only for those whose kind
    names it."""

    kind: Any
    general: ClassVar[bool] = True

    @abc.abstractmethod
    def build(self, plant: Any) -> MakeMetric:
        """From the name of an observer to its metric."""

    @abc.abstractmethod
    def unit(self, units: tuple[str, ...]) -> str:
        """The unit, where what is estimated has `units`."""


def _joined(units: tuple[str, ...]) -> str:
    """One unit where they are alike."""
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def _norm(wanted: bool) -> dict[str, Any]:
    return {"norm": True} if wanted else {}


class AbstractErrorTable(AbstractMetricTable, abc.ABC):
    """A size of the error."""

    after: NonNegative = key("when it begins to count", "s", default=0.0)
    norm: bool = key("of the whole error, not of each entry", default=False)

    def settings(self) -> dict[str, Any]:
        return {"after": self.after} | _norm(self.norm)


class RMSTable(AbstractErrorTable):
    """The root of the mean squared error."""

    kind: Literal["rms"] = key("the kind of metric")

    def build(self, plant: Any) -> MakeMetric:
        return functools.partial(metrics.RMSError, **self.settings())

    def unit(self, units: tuple[str, ...]) -> str:
        return _joined(units)


class PeakTable(AbstractErrorTable):
    """The largest error."""

    kind: Literal["peak"] = key("the kind of metric")

    def build(self, plant: Any) -> MakeMetric:
        return functools.partial(metrics.PeakError, **self.settings())

    def unit(self, units: tuple[str, ...]) -> str:
        return _joined(units)


class IntegralTable(AbstractErrorTable):
    """The integral of the squared error."""

    kind: Literal["integral_squared"] = key("the kind of metric")

    def build(self, plant: Any) -> MakeMetric:
        return functools.partial(metrics.IntegralSquaredError, **self.settings())

    def unit(self, units: tuple[str, ...]) -> str:
        return _joined(tuple(f"({unit})^2 s" for unit in units))


class FinalTable(AbstractMetricTable):
    """The last error."""

    kind: Literal["final"] = key("the kind of metric")
    norm: bool = key("of the whole error, not of each entry", default=False)

    def build(self, plant: Any) -> MakeMetric:
        return functools.partial(metrics.FinalError, **_norm(self.norm))

    def unit(self, units: tuple[str, ...]) -> str:
        return _joined(units)


class SettlingTable(AbstractMetricTable):
    """When the error has settled."""

    kind: Literal["settling"] = key("the kind of metric")
    tolerance: Positive = key("of the norm of the error, in its units")

    def build(self, plant: Any) -> MakeMetric:
        return functools.partial(metrics.SettlingTime, tolerance=self.tolerance)

    def unit(self, units: tuple[str, ...]) -> str:
        return "s"


class AngleTable(AbstractMetricTable):
    """The error of the angle of a motor's magnet, in electrical degrees."""

    kind: Literal["angle", "peak_angle"] = key("the kind of metric")
    after: NonNegative = key("when it begins to count", "s", default=0.0)

    general = False

    def build(self, plant: Any) -> MakeMetric:
        peak = self.kind == "peak_angle"
        metric = metrics.PeakAngleError if peak else metrics.AngleError
        truth = metrics.RotorAngle(plant.pole_pairs)

        def make(observer: str) -> metrics.AbstractMetric:
            estimate = metrics.FluxAngle(observer, plant.inductance)
            return metric(estimate, truth, self.after)

        return make

    def unit(self, units: tuple[str, ...]) -> str:
        return "electrical degrees"


class CoastingTable(AbstractMetricTable):
    """The part of the time that is coasted through."""

    kind: Literal["coasting"] = key("the kind of metric")

    def build(self, plant: Any) -> MakeMetric:
        return metrics.CoastingFraction

    def unit(self, units: tuple[str, ...]) -> str:
        return "1"


class DivergedTable(AbstractMetricTable):
    """Whether the estimate diverged."""

    kind: Literal["diverged"] = key("the kind of metric")
    bound: Positive = key("of the norm of the error, in its units")
    after: NonNegative = key("when it begins to count", "s", default=0.0)

    def build(self, plant: Any) -> MakeMetric:
        settings = dict(bound=self.bound, after=self.after)
        return functools.partial(metrics.Diverged, **settings)

    def unit(self, units: tuple[str, ...]) -> str:
        return "1"


Metric = Annotated[
    RMSTable
    | PeakTable
    | IntegralTable
    | FinalTable
    | SettlingTable
    | AngleTable
    | CoastingTable
    | DivergedTable,
    Field(discriminator="kind"),
]
