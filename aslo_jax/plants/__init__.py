"""Plants: the systems whose states are observed."""

from ._base import AbstractPlant as AbstractPlant
from ._bearing import (
    BearingFluxRelation as BearingFluxRelation,
    BearingState as BearingState,
    MagneticBearing as MagneticBearing,
)
from ._chain import ChainRelation as ChainRelation, IntegratorChain as IntegratorChain
from ._interior_pmsm import (
    InteriorPMSM as InteriorPMSM,
    SalientFluxRelation as SalientFluxRelation,
    SelfConsistentFluxRelation as SelfConsistentFluxRelation,
)
from ._machine import AbstractMachine as AbstractMachine, MachineState as MachineState
from ._magnet import (
    AbstractMagnetMachine as AbstractMagnetMachine,
    AbstractRoundMachine as AbstractRoundMachine,
    FluxRelation as FluxRelation,
)
from ._mechanical import (
    AbstractMechanicalSystem as AbstractMechanicalSystem,
    MechanicalState as MechanicalState,
    MechanicalSystem as MechanicalSystem,
)
from ._mechanisms import (
    BallBeam as BallBeam,
    CartOnArm as CartOnArm,
    Drive as Drive,
    InertiaWheelPendulum as InertiaWheelPendulum,
    RoboticLeg as RoboticLeg,
    VariableLengthPendulum as VariableLengthPendulum,
)
from ._pmsm import PMSM as PMSM
from ._stepper import Stepper as Stepper
from ._wrim import WRIM as WRIM, WindingFluxRelation as WindingFluxRelation

__all__ = [
    "PMSM",
    "WRIM",
    "AbstractMachine",
    "AbstractMechanicalSystem",
    "AbstractPlant",
    "BallBeam",
    "BearingFluxRelation",
    "BearingState",
    "CartOnArm",
    "ChainRelation",
    "Drive",
    "FluxRelation",
    "InertiaWheelPendulum",
    "IntegratorChain",
    "InteriorPMSM",
    "MachineState",
    "MagneticBearing",
    "MechanicalState",
    "MechanicalSystem",
    "RoboticLeg",
    "SalientFluxRelation",
    "SelfConsistentFluxRelation",
    "Stepper",
    "VariableLengthPendulum",
    "WindingFluxRelation",
]
