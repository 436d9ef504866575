"""Observers and linear systems of python-control and of SciPy, there and back."""

from ._bag import from_bag as from_bag
from ._control import to_nlsys as to_nlsys
from ._gem import from_gem as from_gem
from ._linear import (
    LinearPlant as LinearPlant,
    kalman as kalman,
    luenberger as luenberger,
    plant as plant,
    to_control as to_control,
    to_scipy as to_scipy,
)
from ._motulator import from_motulator as from_motulator
from ._motulator_observer import (
    MotulatorObserver as MotulatorObserver,
    MotulatorOutputs as MotulatorOutputs,
)

__all__ = [
    "LinearPlant",
    "MotulatorObserver",
    "MotulatorOutputs",
    "from_bag",
    "from_gem",
    "from_motulator",
    "kalman",
    "luenberger",
    "plant",
    "to_control",
    "to_nlsys",
    "to_scipy",
]
