"""What may be wrong with a log of a turning flux, each as a change of its signals."""

import dataclasses
import shlex
from collections.abc import Callable, Sequence
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
    - `angle`: the factor that mends the angle of a log in dq, where the maps are then
      meant; `None` where they are meant in alpha and beta;
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
    angle: float | None = None
    free: tuple[Free, ...] = ()
    starts: tuple[float, ...] = (0.0,)
    of: Literal["log", "machine"] = "log"
    plain: int = 2


def real_linear(function: Callable[[float, float], complex | float]) -> Map:
    """The map of alpha and beta that `function` is."""
    x, y = function(1.0, 0.0), function(0.0, 1.0)
    return 0.5 * (x - 1j * y), 0.5 * (x + 1j * y)


def scaled(factor: float) -> Map:
    """The map that divides by `factor`."""
    return (1.0 / factor, 0.0)


def mapped(signal: str, change: Map) -> Any:
    """The map of one signal, `"voltage"` or `"current"`, as an argument."""
    return {signal: change}


def apply(change: Map, z: Complex[np.ndarray, "*shape"]) -> Complex[np.ndarray, "*shape"]:
    """`z` after a map."""
    a, b = change
    if b == 0.0:
        return z if a == 1.0 else a * z
    return a * z + b * z.conj()


def words(circle: Circle) -> dict[str, Any]:
    """What messages are formatted with: `u`, `i` and `uq`, `iq`, the columns of the log and
    the second of them; options that `swap` two; and the parameters."""
    names = circle.labels or circle.symbols
    shown = [quoted(name) for name in names]
    voltages = sum(name.startswith("u") for name in circle.symbols)
    u, i = shown[:voltages], shown[voltages:]
    return {
        "u": listed(u),
        "i": listed(i),
        "ud": u[0],
        "uq": u[1],
        "id": i[0],
        "iq": i[1],
        "swap_u": _swapped(circle.symbols[:2], names[:2]),
        "swap_i": _swapped(
            circle.symbols[voltages : voltages + 2], names[voltages : voltages + 2]
        ),
        "angle": f"`{circle.angle}`",
        "R": circle.resistance,
        "L": circle.inductance,
        "m": circle.radius,
        "unit": circle.radius_unit,
        "resistance": circle.resistance_name,
        "inductance": circle.inductance_name,
        "radius": circle.radius_name,
    }


def quoted(name: str) -> str:
    """A column as it stands in an option --column."""
    return name if name.isidentifier() else f"`{name}`"


def listed(names: Sequence[str]) -> str:
    """In words."""
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _swapped(symbols: Sequence[str], names: Sequence[str]) -> str:
    """Options that read each of two columns as the other."""
    pairs = zip(symbols, reversed(names), strict=True)
    return " ".join(f"--column {shlex.quote(f'{ours}={name}')}" for ours, name in pairs)
