"""Plants: the systems whose states are observed."""

from ._base import AbstractPlant as AbstractPlant
from ._battery import Battery as Battery
from ._bearing import (
    BearingFluxRelation as BearingFluxRelation,
    BearingState as BearingState,
    MagneticBearing as MagneticBearing,
)
from ._cart_pole import CartPole as CartPole
from ._chain import ChainRelation as ChainRelation, IntegratorChain as IntegratorChain
from ._chemostat import Chemostat as Chemostat
from ._converters import Boost as Boost, Buck as Buck, Cuk as Cuk
from ._dc_motor import (
    DCMotor as DCMotor,
    DCMotorWithTachometer as DCMotorWithTachometer,
)
from ._drone import Drone as Drone
from ._interior_pmsm import (
    InteriorPMSM as InteriorPMSM,
    SalientFluxRelation as SalientFluxRelation,
    SelfConsistentFluxRelation as SelfConsistentFluxRelation,
)
from ._lateral_vehicle import LateralVehicle as LateralVehicle
from ._levitation import Levitation as Levitation
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
from ._modelled import (
    AbstractModelledPlant as AbstractModelledPlant,
    AbstractVectorPlant as AbstractVectorPlant,
    Span as Span,
    parameter as parameter,
)
from ._oscillators import Lorenz as Lorenz, VanDerPol as VanDerPol
from ._pmsm import PMSM as PMSM
from ._stepper import Stepper as Stepper
from ._synchronous_reluctance import SynchronousReluctance as SynchronousReluctance
from ._wrim import WRIM as WRIM, WindingFluxRelation as WindingFluxRelation

__all__ = [
    "PMSM",
    "WRIM",
    "AbstractMachine",
    "AbstractMechanicalSystem",
    "AbstractModelledPlant",
    "AbstractPlant",
    "AbstractVectorPlant",
    "BallBeam",
    "Battery",
    "BearingFluxRelation",
    "BearingState",
    "Boost",
    "Buck",
    "CartOnArm",
    "CartPole",
    "ChainRelation",
    "Chemostat",
    "Cuk",
    "DCMotor",
    "DCMotorWithTachometer",
    "Drive",
    "Drone",
    "FluxRelation",
    "InertiaWheelPendulum",
    "IntegratorChain",
    "InteriorPMSM",
    "LateralVehicle",
    "Levitation",
    "Lorenz",
    "MachineState",
    "MagneticBearing",
    "MechanicalState",
    "MechanicalSystem",
    "RoboticLeg",
    "SalientFluxRelation",
    "SelfConsistentFluxRelation",
    "Span",
    "Stepper",
    "SynchronousReluctance",
    "VanDerPol",
    "VariableLengthPendulum",
    "WindingFluxRelation",
    "parameter",
]
