"""Observers: the protocol, the algebraic ones, their peers, and compositions."""

from ._adaptive import Adaptive as Adaptive, AdaptiveEstimate as AdaptiveEstimate
from ._adaptive_velocities import AdaptiveVelocities as AdaptiveVelocities
from ._algebraic import AlgebraicObserver as AlgebraicObserver
from ._angle import (
    AlgebraicMagnet as AlgebraicMagnet,
    MagnetAngle as MagnetAngle,
    electrical_angle as electrical_angle,
    rotor_angle as rotor_angle,
    track_angle as track_angle,
)
from ._asymptotic import Asymptotic as Asymptotic
from ._base import (
    AbstractObserver as AbstractObserver,
    Estimate as Estimate,
    ObserverState as ObserverState,
)
from ._bearing import BearingObserver as BearingObserver
from ._compose import Joined as Joined, SideBySide as SideBySide, Staged as Staged
from ._copy import Luenberger as Luenberger
from ._differentiators import (
    FilteredDerivative as FilteredDerivative,
    HighGain as HighGain,
    SuperTwisting as SuperTwisting,
)
from ._extended_kalman import Belief as Belief, ExtendedKalman as ExtendedKalman
from ._fo1 import FO1 as FO1
from ._fo2 import FO2 as FO2
from ._fo3 import FO3 as FO3
from ._gated import Gated as Gated
from ._kalman import SteadyStateKalman as SteadyStateKalman
from ._lifted import Lifted as Lifted
from ._lifted_velocities import LiftedVelocities as LiftedVelocities
from ._luenberger import ReducedLuenberger as ReducedLuenberger
from ._models import (
    AbstractModel as AbstractModel,
    MechanicalModel as MechanicalModel,
    PMSMModel as PMSMModel,
)
from ._open_loop import OpenLoopIntegrator as OpenLoopIntegrator
from ._plant_model import MachineModel as MachineModel, PlantModel as PlantModel
from ._pll import PhaseLockedLoop as PhaseLockedLoop, wrap as wrap
from ._self_consistent import SelfConsistent as SelfConsistent
from ._unwrapped import Unwrapped as Unwrapped
from ._velocity import (
    CoordinateVelocity as CoordinateVelocity,
    MomentumRelation as MomentumRelation,
    Velocities as Velocities,
    VelocityObserver as VelocityObserver,
    velocity_observer as velocity_observer,
)

__all__ = [
    "FO1",
    "FO2",
    "FO3",
    "AbstractModel",
    "AbstractObserver",
    "Adaptive",
    "AdaptiveEstimate",
    "AdaptiveVelocities",
    "AlgebraicMagnet",
    "AlgebraicObserver",
    "Asymptotic",
    "BearingObserver",
    "Belief",
    "CoordinateVelocity",
    "Estimate",
    "ExtendedKalman",
    "FilteredDerivative",
    "HighGain",
    "Joined",
    "Lifted",
    "LiftedVelocities",
    "Luenberger",
    "MachineModel",
    "MagnetAngle",
    "MechanicalModel",
    "MomentumRelation",
    "ObserverState",
    "OpenLoopIntegrator",
    "PMSMModel",
    "PhaseLockedLoop",
    "PlantModel",
    "ReducedLuenberger",
    "SelfConsistent",
    "SideBySide",
    "Staged",
    "SteadyStateKalman",
    "SuperTwisting",
    "Unwrapped",
    "Velocities",
    "VelocityObserver",
    "electrical_angle",
    "rotor_angle",
    "track_angle",
    "velocity_observer",
    "wrap",
]
