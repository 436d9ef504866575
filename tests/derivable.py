"""Systems whose observers are derived, each with a motion: asymmetric parameters, and the
largest relative error that the theory's page gives for it."""

from collections.abc import Callable

from derivable_case import Case
from derivable_electrical import (
    battery,
    boost,
    buck,
    cuk,
    dc_motor_from_current,
    dc_motor_from_speed,
    levitation,
    pmsm,
    synrm,
)
from derivable_others import (
    cart_pole,
    chemostat,
    drone,
    epidemic,
    lorenz,
    rigid_body,
    tube,
    two_tanks,
    unicycle,
    van_der_pol,
    vehicle,
)

CASES: dict[str, Callable[[], Case]] = {
    "buck": buck,
    "boost": boost,
    "cuk": cuk,
    "levitation": levitation,
    "synrm": synrm,
    "pmsm": pmsm,
    "dc_motor_from_speed": dc_motor_from_speed,
    "dc_motor_from_current": dc_motor_from_current,
    "battery": battery,
    "two_tanks": two_tanks,
    "chemostat": chemostat,
    "vehicle": vehicle,
    "unicycle": unicycle,
    "van_der_pol": van_der_pol,
    "van_der_pol_from_speed": lambda: van_der_pol("speed"),
    "lorenz_from_x1": lambda: lorenz(1),
    "lorenz_from_x2": lambda: lorenz(2),
    "lorenz_from_x3": lambda: lorenz(3),
    "epidemic": epidemic,
    "drone": drone,
}
CHANGED: dict[str, Callable[[], Case]] = {
    "drone_quadratic": lambda: drone("quadratic"),
    "tube": tube,
    "cart_pole": cart_pole,
    "rigid_body": rigid_body,
}
