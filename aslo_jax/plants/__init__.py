"""Plants: the systems whose states are observed."""

from .base import AbstractPlant as AbstractPlant
from .bearing import (
    BearingFluxRelation as BearingFluxRelation,
    BearingState as BearingState,
    MagneticBearing as MagneticBearing,
)
from .chain import ChainRelation as ChainRelation, IntegratorChain as IntegratorChain
from .interior_pmsm import (
    InteriorPMSM as InteriorPMSM,
    SalientFluxRelation as SalientFluxRelation,
    SelfConsistentFluxRelation as SelfConsistentFluxRelation,
)
from .machine import AbstractMachine as AbstractMachine, MachineState as MachineState
from .magnet import (
    AbstractMagnetMachine as AbstractMagnetMachine,
    AbstractRoundMachine as AbstractRoundMachine,
    FluxRelation as FluxRelation,
)
from .mechanical import (
    AbstractMechanicalSystem as AbstractMechanicalSystem,
    MechanicalState as MechanicalState,
    MechanicalSystem as MechanicalSystem,
)
from .mechanisms import (
    BallBeam as BallBeam,
    CartOnArm as CartOnArm,
    InertiaWheelPendulum as InertiaWheelPendulum,
    RoboticLeg as RoboticLeg,
    VariableLengthPendulum as VariableLengthPendulum,
)
from .pmsm import PMSM as PMSM
from .stepper import Stepper as Stepper
from .wrim import WRIM as WRIM, WindingFluxRelation as WindingFluxRelation
