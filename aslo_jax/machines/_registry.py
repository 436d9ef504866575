"""The kinds of machines: a kind is one file and one line here."""

from ..schema import choices, hint
from ._ball_beam import BallBeamDescription
from ._base import AbstractDescription, MachineError
from ._derived import DerivedDescription
from ._double_integrator import STUDY as DOUBLE_INTEGRATOR
from ._drive import DriveDescription
from ._interior_pmsm import InteriorPMSMDescription
from ._magnetic_bearing import MagneticBearingDescription
from ._mechanical import MechanicalDescription
from ._modelled import STUDIES as MODELLED
from ._pmsm import PMSMDescription
from ._robotic_leg import RoboticLegDescription
from ._stepper import StepperDescription
from ._study import Study
from ._wrim import WRIMDescription

Kind = type[AbstractDescription]

KINDS: dict[str, Kind] = {
    description.kind: description
    for description in (
        PMSMDescription,
        StepperDescription,
        InteriorPMSMDescription,
        WRIMDescription,
        MagneticBearingDescription,
        RoboticLegDescription,
        BallBeamDescription,
        DriveDescription,
        MechanicalDescription,
        DerivedDescription,
    )
}
# Of which there are studies, and no logs.
IDEAL: dict[str, Study] = {study.kind: study for study in (DOUBLE_INTEGRATOR, *MODELLED)}


def known_kind(name: object, what: str = "`machine.kind`") -> Kind:
    """The kind of that name; `what` begins the message where there is none.

    **Raises:** [`MachineError`][], with the nearest kind.
    """
    if isinstance(name, str) and name in KINDS:
        return KINDS[name]
    near = hint(str(name), KINDS, "; did you mean `{}`?")
    raise MachineError(
        f"{what} must be one of {choices(KINDS)}, but is {name!r}{near or '.'}"
    )


def studies() -> dict[str, Study]:
    """How each kind that takes part in studies does, by its name."""
    offered = {name: kind.study for name, kind in KINDS.items()}
    return IDEAL | {name: study for name, study in offered.items() if study is not None}
