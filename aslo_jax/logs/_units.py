"""Units of columns: read from a header, and converted to those of the SI.

pint knows the units; it is imported for the first one that is not an SI unit as it stands.
"""

import functools
import re
from typing import Any

from .._extras import require
from ._error import LogError

# The units that a column may have, the one it is converted to first, by its name here.
RULES = (
    (r"t", ("s",)),
    (r"u_\w+", ("V",)),
    (r"i_\w+", ("A",)),
    (r"flux_\w+", ("Wb",)),
    (r"angle|theta\w*", ("rad",)),
    (r"omega\w*", ("rad/s",)),
    (r"u\d+", ("N", "N m")),
    (r"q\d+|position", ("m", "rad")),
    (r"qdot\d+\w*|velocity", ("m/s", "rad/s")),
)
QUANTITIES = {
    "s": "a time",
    "V": "a voltage",
    "A": "a current",
    "Wb": "a flux",
    "rad": "an angle",
    "rad/s": "an angular speed",
    "N": "a force",
    "N m": "a torque",
    "m": "a position",
    "m/s": "a velocity",
}
# How instruments write a unit that pint calls otherwise, or takes for another one.
SPELLINGS = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "volt": "V",
    "volts": "V",
    "amp": "A",
    "amps": "A",
    "ampere": "A",
    "vs": "Wb",
    "v s": "Wb",
    "v.s": "Wb",
    "v·s": "Wb",
    "nm": "N m",
    "n.m": "N m",
    "n·m": "N m",
    "n*m": "N m",
    "mvs": "mWb",
    "mnm": "mN m",
    "°": "degree",
    "degs": "degree",
    "rad/sec": "rad/s",
    "rad s^-1": "rad/s",
    "rad·s^-1": "rad/s",
    "deg/s": "degree/s",
    "deg/sec": "degree/s",
    "dps": "degree/s",
    "°/s": "degree/s",
    "rev": "turn",
    "revs": "turn",
    "rev/s": "turn/s",
    "rps": "turn/s",
    "rev/min": "rpm",
    "revs/min": "rpm",
    "r/min": "rpm",
    "u/min": "rpm",
    "upm": "rpm",
    "1/min": "rpm",
    "min^-1": "rpm",
    "min-1": "rpm",
    "min⁻¹": "rpm",
}
PURE = ("", "-", "1", "none")  # of a number without a unit
RELATIVE = ("pu", "p.u.", "per unit", "per-unit", "%", "percent")
TWO_READINGS = ("1/s", "s^-1", "s-1", "s⁻¹", "/s")  # of a speed: rad/s, or turns
ANGLES = {"radian", "degree", "turn", "grade", "arcminute", "arcsecond", "milliradian"}


def units_of(name: str) -> tuple[str, ...]:
    """The SI units that the column `name` of ours may have, none for one that is
    unknown."""
    for pattern, units in RULES:
        if re.fullmatch(pattern, name):
            return units
    return ()


def split_unit(header: str) -> tuple[str, str]:
    """Name and unit of a header such as `Time [ms]`, `n (rpm)`, `I_a/A`, `t in ms`, `t_ms`;
    the unit is empty where there is none."""
    header = header.strip()
    if found := re.fullmatch(r"(.+?)\s*[\[(]([^\[\]()]*\D[^\[\]()]*|)[\])]", header):
        return found[1].strip(), found[2].strip()
    for pattern in (
        r"([^/]*[^/\s])\s*/\s*([^/\s\d][^/]*(?:/[^/]+)?)",
        r"(.+?)\s+in\s+(\S+)",
        r"(.+)_(ms|us|µs|ns|rpm|deg|rad|mA|mV|kV)",
    ):
        found = re.fullmatch(pattern, header)
        if found and is_unit(found[2]):  # which a slash or a word alone does not say
            return found[1].strip(), found[2].strip()
    return header, ""


def is_unit(text: str) -> bool:
    """Whether `text` is a unit, with or without brackets, or says that there is none."""
    text = bare(text)
    if text.lower() in (*PURE, *RELATIVE) or _spelled(text) in QUANTITIES:
        return True
    return bool(text) and not text[0].isdigit() and _parsed(_spelled(text)) is not None


def bare(text: str) -> str:
    """A unit without the brackets around it."""
    return text.strip().strip("[]()").strip()


def factor_of(unit: str, name: str) -> float:
    """What turns numbers of `unit` into those of the SI unit of our column `name`.

    **Raises:** `LogError`, whose text goes on after the name of a column, for a unit that
    is not known, or not one of what the column holds."""
    units, spelled = units_of(name), _spelled(unit)
    if spelled in units:
        return 1.0
    what = " or ".join(f"{QUANTITIES[u]} ({u})" for u in units) or "a quantity with a unit"
    if unit.lower() in PURE and ("rad" in units or not units):
        return 1.0
    if unit.lower() in (*PURE, *RELATIVE):
        raise LogError(f"is without a unit (`{unit}`), but `{name}` is {what}")
    if "rad/s" in units and unit in TWO_READINGS:
        raise LogError(f"is in {unit}, which may be rad/s or turns a second")
    if "rad/s" in units and spelled == "Hz":
        spelled = "turn/s"
    parsed = _parsed(spelled)
    if parsed is None:
        raise LogError(f"is in `{unit}`, which is not a unit that is known")
    registry = _registry()
    one = registry.Quantity(1.0, parsed)
    turns = _turns(parsed)
    for target in units:
        goal = registry.parse_units(target)
        if parsed.dimensionality == goal.dimensionality and turns == _turns(goal):
            return float(one.to(goal).magnitude)
    if units or not one._is_multiplicative:
        raise LogError(f"is in {unit}, but `{name}` is {what}")
    return float(one.to_base_units().magnitude)


def _spelled(unit: str) -> str:
    return SPELLINGS.get(unit.lower(), unit)


@functools.cache
def _registry() -> Any:
    return require("pint", "cli").UnitRegistry()


@functools.cache
def _parsed(unit: str) -> Any:
    try:
        return _registry().parse_units(unit)
    except Exception:  # pint, its parser and its tokens each have their own
        return None


def _turns(unit: Any) -> bool:
    """Whether a unit counts angles, which pint takes for pure numbers."""
    return any(
        name in ANGLES or "revolution" in name or name.endswith(("radian", "degree"))
        for name in unit._units
    )
