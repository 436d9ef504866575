"""`[observers.NAME]` of a study: the keys of each kind of observer.

Which suit a machine, and how they are made of its nominal plant, is said by the kind of
machine ([`aslo_jax.machines.Study`][]).
"""

import abc
from typing import Annotated, Any, Literal

from pydantic import Field

from ...machines._rates import PACE, PerSpeedTable
from ...schema import NonNegative, Positive, Table, key

Deviation = Positive | Annotated[list[Positive], Field(min_length=1)]
DEVIATION = "a positive finite number, or one for each entry of the signal"


class AbstractObserverTable(Table, abc.ABC):
    """An observer."""

    kind: Any


class AbstractAlgebraicTable(AbstractObserverTable, abc.ABC):
    """An algebraic observer, of any machine."""

    cutoff: Positive | PerSpeedTable = key("cutoff of the filter", "rad/s", allowed=PACE)
    completion: Literal["least-squares", "repeat"] = key(
        "from one row to two", default="least-squares"
    )
    threshold: Positive | None = key("certificate below which it coasts", default=None)
    start: Literal["exact", "paper"] = key("how the filters start", default="exact")
    forgetting: Positive | PerSpeedTable | None = key(
        "cutoff of the information matrix, by default that of the filter",
        "rad/s",
        default=None,
        allowed=PACE,
    )
    velocity_cutoff: Positive = key(
        "cutoff of the velocity's filter, of a magnetic bearing", "rad/s", default=200.0
    )


class AlgebraicTable(AbstractAlgebraicTable):
    """The ASLO."""

    kind: Literal["aslo"] = key("the kind of observer")


class AsymptoticTable(AbstractAlgebraicTable):
    """The A-ASLO."""

    kind: Literal["a-aslo"] = key("the kind of observer")
    gain: Positive = key("gain", "rad/s")


class FO1Table(AbstractObserverTable):
    """FO1: a gradient search on the flux's constant."""

    kind: Literal["fo1"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")
    gain: Positive = key("gain", "s/Wb^2")


class FO2Table(AbstractObserverTable):
    """FO2: a gradient search on the known magnet flux."""

    kind: Literal["fo2"] = key("the kind of observer")
    gain: Positive = key("gain", "1/(s Wb^2)")
    one_sided: bool = key("correct only outside of the circle", default=True)


class FO3Table(AbstractObserverTable):
    """FO3: dynamic regressor extension and mixing."""

    kind: Literal["fo3"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")
    gain: Positive = key("gain, SI")


class IntegratorTable(AbstractObserverTable):
    """The integral of what is known, from zero."""

    kind: Literal["open_loop"] = key("the kind of observer")


class LuenbergerTable(AbstractObserverTable):
    """The reduced-order Luenberger observer."""

    kind: Literal["luenberger"] = key("the kind of observer")
    gain: Positive = key("its pole is at minus this", "rad/s")


class KalmanTable(AbstractObserverTable):
    """The Kalman filter: settled for a linear plant, extended for the others."""

    kind: Literal["kalman"] = key("the kind of observer")
    process: Positive | Annotated[list[Positive], Field(min_length=1)] = key(
        "two-sided intensity of the noise on the acceleration (m^2/s^3, rad^2/s^3); of a "
        "plant that is a model, ready-made or one's own, on the rates, over the squares of "
        "half the ranges (1/s)",
        allowed="a positive finite number, or a list of them",
    )
    measurement: Positive | Annotated[list[Positive], Field(min_length=1)] = key(
        "two-sided intensity of the noise on the measurement (its unit squared, s)",
        allowed="a positive finite number, or of a model a list of them",
    )
    drift: Positive | None = key(
        "that on the unknown parameters of a plant that is a model, over the squares of "
        "half their values, by default as `process`",
        "1/s",
        default=None,
    )
    voltage: Positive = key(
        "two-sided intensity of the noise on the voltage of a motor", "V^2 s", default=1e-6
    )


class AbstractNoiseTable(AbstractObserverTable, abc.ABC):
    """A Kalman filter of the plant's relation, which is told of the noise."""

    output_deviation: Deviation = key(
        "standard deviation of the noise on every sample of the output (its unit)",
        allowed=DEVIATION,
    )
    input_deviation: Deviation = key(
        "standard deviation of the noise on every sample of the input (its unit)",
        allowed=DEVIATION,
    )
    force_deviation: Deviation | None = key(
        "of a mechanism: standard deviation of forces that the model does not know, in "
        "every interval (N, N m), by default none",
        default=None,
        allowed="a positive finite number, or one for each coordinate",
    )


class LiftedTable(AbstractNoiseTable):
    """The Kalman filter of the plant's relation, of all velocities of a mechanism."""

    kind: Literal["lifted_kalman"] = key("the kind of observer")
    prior: Positive | None = key(
        "standard deviation of the first belief of every estimated state (its unit), by "
        "default infinite",
        default=None,
    )
    threshold: Annotated[float, Field(gt=0, lt=1)] = key(
        "certificate below which it coasts",
        default=0.9,
        allowed="a number between 0 and 1",
    )


class AdaptiveTable(AbstractNoiseTable):
    """The Kalman filter of the plant's relation, or of all velocities of a mechanism, with
    unknown parameters."""

    kind: Literal["adaptive"] = key("the kind of observer")
    parameters: list[str] = key(
        "what is not known, by name, that with the bank first",
        default=["resistance", "magnet_flux"],
    )
    deviations: list[Positive] = key(
        "standard deviations of these: of a motor relative, of a mechanism in their units",
        default=[0.1, 0.02],
    )
    drift: NonNegative = key(
        "random walk of these: deviation after a second (of a motor relative; 1/sqrt(s))",
        default=0.0,
    )
    hold: Positive = key(
        "of a motor: relative deviation of the first of these above which they may be held",
        default=0.03,
    )
    bank: Annotated[int, Field(ge=3)] = key(
        "of a motor: how many values of the first of these", default=11
    )
    tolerance: Positive = key(
        "relative deviation of x above which its estimate is flagged", default=0.01
    )


Gains = Positive | Annotated[list[Positive], Field(min_length=1)]
GAINS = "a positive finite number, or one for each coordinate"


class HighGainTable(AbstractObserverTable):
    """The high-gain observer of velocities."""

    kind: Literal["high_gain"] = key("the kind of observer")
    bandwidth: Gains = key("both poles are at minus this", "rad/s", allowed=GAINS)
    model: bool = key("whether it knows the acceleration of the plant", default=True)


class SuperTwistingTable(AbstractObserverTable):
    """Levant's differentiator."""

    kind: Literal["super_twisting"] = key("the kind of observer")
    bound: Gains = key("of the acceleration (m/s^2, rad/s^2)", allowed=GAINS)


class DerivativeTable(AbstractObserverTable):
    """The filtered derivative of the positions."""

    kind: Literal["filtered_derivative"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")


Observer = Annotated[
    AlgebraicTable
    | AsymptoticTable
    | FO1Table
    | FO2Table
    | FO3Table
    | IntegratorTable
    | LuenbergerTable
    | KalmanTable
    | LiftedTable
    | AdaptiveTable
    | HighGainTable
    | SuperTwistingTable
    | DerivativeTable,
    Field(discriminator="kind"),
]
