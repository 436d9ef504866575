"""`[observers.NAME]` of a study: each designed for the nominal plant."""

import abc
from typing import Annotated, Any, ClassVar, Literal

import jax.numpy as jnp
from pydantic import Field

from ..._choices import CompletionName, FilterStart
from ...completions import AbstractCompletion, LeastSquares, Repeat
from ...filters import LowPass
from ...guard import Guard
from ...machines.base import Positive, Table, key
from ...observers import (
    FO1,
    FO2,
    FO3,
    AbstractObserver,
    AlgebraicObserver,
    Asymptotic,
    BearingObserver,
    ExtendedKalman,
    FilteredDerivative,
    HighGain,
    Joined,
    OpenLoopIntegrator,
    ReducedLuenberger,
    SteadyStateKalman,
    SuperTwisting,
    Unwrapped,
    velocity_observer,
)
from ...plants import WRIM, AbstractMechanicalSystem, IntegratorChain, MagneticBearing

MECHANISMS = ("robotic_leg", "ball_beam")
MOTORS = ("pmsm",)
FLUXES = (*MOTORS, "wrim")
RELATIONS = ("double_integrator", *FLUXES)
THRESHOLDS = {"robotic_leg": 1e-2, "ball_beam": 1e-2, "magnetic_bearing": 1e-4}


class AbstractObserverTable(Table, abc.ABC):
    """An observer; `machines` are the kinds that it is for."""

    kind: Any
    machines: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def build(self, plant: Any, start: Any) -> AbstractObserver:
        """The observer of a plant that starts in the state `start`."""


class AlgebraicTable(AbstractObserverTable):
    """The ASLO, of any machine."""

    kind: Literal["aslo"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")
    completion: CompletionName = key("from one row to two", default="least-squares")
    threshold: Positive | None = key("certificate below which it coasts", default=None)
    start: FilterStart = key("how the filters start", default="exact")
    forgetting: Positive | None = key(
        "cutoff of the information matrix, by default that of the filter",
        "rad/s",
        default=None,
    )
    velocity_cutoff: Positive = key(
        "cutoff of the velocity's filter, of a magnetic bearing", "rad/s", default=200.0
    )

    machines = (*RELATIONS, *MECHANISMS, "magnetic_bearing")

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return algebraic(self, plant, None)


class AsymptoticTable(AlgebraicTable):
    """The A-ASLO."""

    kind: Literal["a-aslo"] = key("the kind of observer")  # pyright: ignore[reportIncompatibleVariableOverride]
    gain: Positive = key("gain", "rad/s")

    machines = (*RELATIONS, *MECHANISMS)

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return algebraic(self, plant, self.gain)


def algebraic(table: AlgebraicTable, plant: Any, gain: float | None) -> AbstractObserver:
    """The ASLO of a table, or with a `gain` (rad/s) the A-ASLO."""
    kind = "magnetic_bearing" if isinstance(plant, MagneticBearing) else "pmsm"
    mechanical = isinstance(plant, AbstractMechanicalSystem)
    kind = "robotic_leg" if mechanical else kind
    threshold = THRESHOLDS.get(kind, 1e-3) if table.threshold is None else table.threshold
    guard, filter = Guard(threshold), LowPass(table.cutoff)
    if mechanical:
        completion = Repeat() if table.completion == "repeat" else LeastSquares()
        return velocity_observer(
            plant, filter, gain=gain, completion=completion, guard=guard, start=table.start
        )

    def one(relation: Any) -> AbstractObserver:
        inner = AlgebraicObserver(relation, filter, _completion(table), guard, table.start)
        return inner if gain is None else Asymptotic(inner, gain)

    if isinstance(plant, MagneticBearing):
        flux = one(plant.flux_relation())
        assert isinstance(flux, AlgebraicObserver)
        return BearingObserver(flux, LowPass(table.velocity_cutoff))
    return _each(plant, one)


def _completion(table: AlgebraicTable) -> AbstractCompletion:
    if table.completion == "repeat":
        return Repeat()
    return LeastSquares(None if table.forgetting is None else LowPass(table.forgetting))


def _each(plant: Any, one: Any) -> AbstractObserver:
    """An observer of the plant's relation, or of those of both of its windings."""
    if isinstance(plant, IntegratorChain):
        return one(plant.relation())
    if isinstance(plant, WRIM):
        return Joined(tuple(one(plant.flux_relation(w)) for w in ("stator", "rotor")))
    return one(plant.flux_relation())


class FO1Table(AbstractObserverTable):
    """FO1: a gradient search on the flux's constant."""

    kind: Literal["fo1"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")
    gain: Positive = key("gain", "s/Wb^2")

    machines = MOTORS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return FO1(plant.flux_relation(), LowPass(self.cutoff), self.gain)


class FO2Table(AbstractObserverTable):
    """FO2: a gradient search on the known magnet flux."""

    kind: Literal["fo2"] = key("the kind of observer")
    gain: Positive = key("gain", "1/(s Wb^2)")
    one_sided: bool = key("correct only outside of the circle", default=True)

    machines = MOTORS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return FO2(plant.flux_relation(), self.gain, self.one_sided)


class FO3Table(AbstractObserverTable):
    """FO3: dynamic regressor extension and mixing."""

    kind: Literal["fo3"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")
    gain: Positive = key("gain, SI")

    machines = FLUXES

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return _each(plant, lambda r: FO3(r, LowPass(self.cutoff), self.gain))


class IntegratorTable(AbstractObserverTable):
    """The integral of what is known, from zero."""

    kind: Literal["open_loop"] = key("the kind of observer")

    machines = RELATIONS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return _each(plant, OpenLoopIntegrator)


class LuenbergerTable(AbstractObserverTable):
    """The reduced-order Luenberger observer."""

    kind: Literal["luenberger"] = key("the kind of observer")
    gain: Positive = key("its pole is at minus this", "rad/s")

    machines = ("double_integrator",)

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return ReducedLuenberger.of_chain(2, self.gain)


class KalmanTable(AbstractObserverTable):
    """The Kalman filter: settled for a linear plant, extended for the others."""

    kind: Literal["kalman"] = key("the kind of observer")
    process: Positive | Annotated[list[Positive], Field(min_length=1)] = key(
        "two-sided intensity of the noise on the acceleration (m^2/s^3, rad^2/s^3)",
        allowed="a positive finite number, or a list of them",
    )
    measurement: Positive = key(
        "two-sided intensity of the noise on the measurement (its unit squared, s)"
    )
    voltage: Positive = key(
        "two-sided intensity of the noise on the voltage of a motor", "V^2 s", default=1e-6
    )

    machines = ("double_integrator", *MOTORS, *MECHANISMS)

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        process = jnp.asarray(self.process, float)
        if isinstance(plant, IntegratorChain):
            A, B, C = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]]
            return SteadyStateKalman.design(
                A, B, C, float(process), self.measurement, [[0.0, 1.0]]
            )
        if isinstance(plant, AbstractMechanicalSystem):
            kalman = ExtendedKalman.of_mechanical(
                plant, process, self.measurement, 1.0, initial=start.position
            )
            return _unwrapped(kalman, plant)
        return ExtendedKalman.of_pmsm(
            plant.flux_relation(), self.voltage, process, self.measurement
        )


Gains = Positive | Annotated[list[Positive], Field(min_length=1)]
GAINS = "a positive finite number, or one for each coordinate"


class HighGainTable(AbstractObserverTable):
    """The high-gain observer of velocities."""

    kind: Literal["high_gain"] = key("the kind of observer")
    bandwidth: Gains = key("both poles are at minus this", "rad/s", allowed=GAINS)
    model: bool = key("whether it knows the acceleration of the plant", default=True)

    machines = MECHANISMS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        gain = jnp.asarray(self.bandwidth, float)
        return _unwrapped(HighGain(gain, plant if self.model else None), plant)


class SuperTwistingTable(AbstractObserverTable):
    """Levant's differentiator."""

    kind: Literal["super_twisting"] = key("the kind of observer")
    bound: Gains = key("of the acceleration (m/s^2, rad/s^2)", allowed=GAINS)

    machines = MECHANISMS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return _unwrapped(SuperTwisting(jnp.asarray(self.bound, float)), plant)


class DerivativeTable(AbstractObserverTable):
    """The filtered derivative of the positions."""

    kind: Literal["filtered_derivative"] = key("the kind of observer")
    cutoff: Positive = key("cutoff of the filter", "rad/s")

    machines = MECHANISMS

    def build(self, plant: Any, start: Any) -> AbstractObserver:
        return _unwrapped(FilteredDerivative(LowPass(self.cutoff)), plant)


def _unwrapped(observer: AbstractObserver, plant: AbstractMechanicalSystem):
    return Unwrapped(observer, plant.angles) if any(plant.angles) else observer


Observer = Annotated[
    AlgebraicTable
    | AsymptoticTable
    | FO1Table
    | FO2Table
    | FO3Table
    | IntegratorTable
    | LuenbergerTable
    | KalmanTable
    | HighGainTable
    | SuperTwistingTable
    | DerivativeTable,
    Field(discriminator="kind"),
]
