"""The rates of an observer: numbers, or what follows the speed."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float
from pydantic import model_validator

from .._filters import LowPass
from .._module import Module
from .._schedules import PerSpeed
from .._typing import PyTree
from ..plants import FluxRelation
from ..schema import Positive, Table, key


class PerSpeedTable(Table):
    """A rate that follows the speed at which the estimate turns."""

    per_speed: Positive = key("the rate over that speed (1)", default=1.0)
    low: Positive = key("the least rate", "rad/s", default=2.0)
    high: Positive = key("the greatest rate", "rad/s", default=300.0)
    bandwidth: Positive = key("of the loop that finds the speed", "rad/s", default=60.0)

    @model_validator(mode="after")
    def _ordered(self):
        if self.low > self.high:
            raise ValueError(
                "`low` of a rate must be at most `high` (rad/s), but they are "
                f"{self.low:g} and {self.high:g}"
            )
        return self


PACE = (
    "a positive finite number, or { per_speed = 1.0, low = 2.0, high = 300.0 } for a rate "
    "that follows the speed"
)


class Rate(NamedTuple):
    """The `value` of a rate of an observer (rad/s), and the `reason` for it, a clause,
    empty where the user gave it.
    """

    value: float | PerSpeedTable
    reason: str = ""

    @property
    def constant(self) -> float:
        """The value of a rate that does not vary.

        **Raises:** `TypeError` for one that does."""
        if isinstance(self.value, PerSpeedTable):
            raise TypeError(f"This rate must be a number, but is {self}.")
        return self.value

    @property
    def least(self) -> float:
        """The value, or the least one."""
        return self.value.low if isinstance(self.value, PerSpeedTable) else self.value

    def __str__(self) -> str:
        pace = self.value
        if not isinstance(pace, PerSpeedTable):
            return f"{pace:.4g} rad/s"
        return (
            f"{pace.per_speed:.4g} times the electrical speed, from {pace.low:.4g} to "
            f"{pace.high:.4g} rad/s"
        )

    def as_json(self) -> float | dict[str, float]:
        """For programs."""
        pace = self.value
        return pace.model_dump() if isinstance(pace, PerSpeedTable) else float(pace)


Rates = dict[str, Rate]


class _Magnet(Module):
    """What turns of a motor: its flux without the armature's."""

    inductance: Float[Array, ""]

    def __call__(self, u: PyTree, y: PyTree, value: Array) -> Array:
        return value - self.inductance * y


def low_pass(cutoff: float | PerSpeedTable, relation: Any) -> LowPass:
    """The filter of a `cutoff`, a number (rad/s) or the table of one that follows the speed
    at which the estimate of a `relation` turns.

    **Raises:** `ValueError` for the table with a relation of which nothing turns.
    """
    if not isinstance(cutoff, PerSpeedTable):
        return LowPass(cutoff)
    if not isinstance(relation, FluxRelation):
        raise ValueError(
            "a cutoff that follows the speed needs the flux of a round motor, which this "
            "machine has not; give a number (rad/s)"
        )
    return LowPass(PerSpeed(**cutoff.model_dump(), vector=_Magnet(relation.inductance)))
