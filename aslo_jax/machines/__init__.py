"""Machine descriptions: a validated TOML file to a plant and its observer.

[machine]
kind = "pmsm"           # or "stepper", "interior_pmsm", "wrim", "magnetic_bearing",
                        # "robotic_leg", "ball_beam", "drive", "mechanical", "derived"
resistance = 8.875      # ohm
inductance = 40.03e-3   # H
magnet_flux = 0.2086    # Wb
pole_pairs = 5
inertia = 60e-6         # kg m^2

[observer]              # every key is optional
cutoff = 150.0          # rad/s

A kind is one module with one final class, and one line in the registry. The class says all
that is special about its machines: columns, keys and thresholds, the observer, what can be
calibrated, and how they take part in studies.
"""

from . import motor as motor, offers as offers
from ._ball_beam import BallBeamDescription as BallBeamDescription
from ._base import (
    AbstractDescription as AbstractDescription,
    Layout as Layout,
    MachineError as MachineError,
    Quantity as Quantity,
    Rate as Rate,
    Unknowns as Unknowns,
)
from ._derived import DerivedDescription as DerivedDescription
from ._derived_study import load_derivable as load_derivable, load_model as load_model
from ._drive import DriveDescription as DriveDescription
from ._file import (
    machine_of as machine_of,
    read_machine as read_machine,
    template as template,
)
from ._frequency import (
    cutoff_for_positions as cutoff_for_positions,
    typical_frequency as typical_frequency,
)
from ._interior_pmsm import InteriorPMSMDescription as InteriorPMSMDescription
from ._magnetic_bearing import MagneticBearingDescription as MagneticBearingDescription
from ._mechanical import MechanicalDescription as MechanicalDescription
from ._pmsm import PMSMDescription as PMSMDescription
from ._registry import KINDS as KINDS, known_kind as known_kind, studies as studies
from ._robotic_leg import RoboticLegDescription as RoboticLegDescription
from ._speed import cutoff_for as cutoff_for, electrical_speed as electrical_speed
from ._stepper import StepperDescription as StepperDescription
from ._study import Study as Study
from ._wrim import WRIMDescription as WRIMDescription

__all__ = [
    "KINDS",
    "AbstractDescription",
    "BallBeamDescription",
    "DerivedDescription",
    "DriveDescription",
    "InteriorPMSMDescription",
    "Layout",
    "MachineError",
    "MagneticBearingDescription",
    "MechanicalDescription",
    "PMSMDescription",
    "Quantity",
    "Rate",
    "RoboticLegDescription",
    "StepperDescription",
    "WRIMDescription",
    "cutoff_for",
    "cutoff_for_positions",
    "electrical_speed",
    "load_derivable",
    "load_model",
    "read_machine",
    "template",
    "typical_frequency",
]
