"""What may be wrong with a log of a turning flux, each as a change of its signals."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from jaxtyping import Complex

from ._circle import Circle

# A real-linear map of alpha + j beta: z -> a z + b conj(z).
Map = tuple[complex | float, complex | float]
SAME: Map = (1.0, 0.0)

# What may be fitted, and its unit: what is added to the resistance (ohm) and to the
# inductance (H), what voltage and current are too small by (relative), constant voltages
# (V), and what dead time takes off (V).
Free = Literal["resistance", "inductance", "voltage", "current", "alpha", "beta", "dead"]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A change of the signals or the parameters under which a log may be right.

    - `kind`: its key; `cause`: what is wrong, in words; `remedy`: what to try; both are
      format strings, of the names in [`words`][] and the fitted value `{0}`;
    - `voltage`, `current`: the maps that mend them, `shift` the rows by which the voltage
      is moved; `resistance`, `inductance`: the factors that mend the parameters;
    - `free`: what is fitted; `starts`: from where, the first of it: of resistance and
      inductance in units of their own;
    - `of`: whether the log or the machine's description is wrong;
    - `plain`: how likely it is beside others that explain as much, the larger the likelier.
    """

    kind: str
    cause: str
    remedy: str = ""
    voltage: Map = SAME
    current: Map = SAME
    shift: float = 0.0
    resistance: float = 1.0
    inductance: float = 1.0
    free: tuple[Free, ...] = ()
    starts: tuple[float, ...] = (0.0,)
    of: Literal["log", "machine"] = "log"
    plain: int = 2


def real_linear(function: Callable[[float, float], complex | float]) -> Map:
    """The map of alpha and beta that `function` is."""
    x, y = function(1.0, 0.0), function(0.0, 1.0)
    return 0.5 * (x - 1j * y), 0.5 * (x + 1j * y)


def apply(change: Map, z: Complex[np.ndarray, "*shape"]) -> Complex[np.ndarray, "*shape"]:
    """`z` after a map."""
    a, b = change
    if b == 0.0:
        return z if a == 1.0 else a * z
    return a * z + b * z.conj()


def words(circle: Circle) -> dict[str, Any]:
    """What messages are formatted with."""
    ua, ub, ia, ib = circle.symbols
    return {
        "ua": ua,
        "ub": ub,
        "ia": ia,
        "ib": ib,
        "R": circle.resistance,
        "L": circle.inductance,
        "m": circle.radius,
        "unit": circle.radius_unit,
        "resistance": circle.resistance_name,
        "inductance": circle.inductance_name,
        "radius": circle.radius_name,
    }
