"""How others call the columns of a log, and what kind of quantity a name stands for."""

import re
from itertools import product

from ._units import units_of

GREEK = {"α": "alpha", "β": "beta", "θ": "theta", "ϑ": "theta", "ω": "omega"}
GREEK |= {"ψ": "psi", "Ψ": "psi", "φ": "phi", "λ": "lambda"}

# What begins a name, by what begins ours.
BEGINNINGS = {
    "u": ("u", "v", "us", "vs", "ustator", "vstator", "voltage", "statorvoltage"),
    "i": ("i", "is", "istator", "current", "statorcurrent"),
    "flux": ("flux", "psi", "lambda", "psis", "fluxs", "lambdas", "statorflux"),
    "u_s": ("us", "vs", "ustator", "vstator", "statorvoltage"),
    "i_s": ("is", "istator", "statorcurrent"),
    "flux_s": ("fluxs", "psis", "lambdas", "statorflux"),
    "u_r": ("ur", "vr", "urotor", "vrotor", "rotorvoltage"),
    "i_r": ("ir", "irotor", "rotorcurrent"),
    "flux_r": ("fluxr", "psir", "lambdar", "rotorflux"),
}
ENDINGS = {
    **{end: (end,) for end in ("alpha", "beta", "d", "q")},
    "a": ("a", "an", "phasea"),
    "b": ("b", "bn", "phaseb"),
    "c": ("c", "cn", "phasec"),
}
ELECTRICAL = ("electrical", "e", "el", "elec", "elect", "electric")
MECHANICAL = ("mechanical", "m", "mech", "mechanic")
ANGLES = ("theta", "angle", "rotorangle", "angletheta", "thetarotor")
SPEEDS = ("omega", "w", "speed", "omegarotor", "rotorspeed")
OTHERS = {
    "t": {"t", "time", "zeit", "tsec", "timesec", "seconds"},
    "theta_electrical": {a + e for a, e in product(ANGLES, ELECTRICAL)}
    | {e + a for a, e in product(ANGLES, ELECTRICAL) if len(e) > 1},
    "theta_mechanical": {a + m for a, m in product(ANGLES, MECHANICAL)}
    | {m + a for a, m in product(ANGLES, MECHANICAL) if len(m) > 1},
    "omega_electrical": {a + e for a, e in product(SPEEDS, ELECTRICAL)}
    | {e + a for a, e in product(SPEEDS, ELECTRICAL) if len(e) > 1},
    "omega_mechanical": {a + m for a, m in product(SPEEDS, MECHANICAL)}
    | {m + a for a, m in product(SPEEDS, MECHANICAL) if len(m) > 1},
}
# A speed in turns a minute is the shaft's.
TURNS = {"n", "nm", "nmech", "speed", "rpm", "rotorspeed", "motorspeed", "shaftspeed"}

UNITS = {"s": ("time",), "V": ("voltage",), "A": ("current",), "Wb": ("flux",)}
UNITS |= {"rad": ("angle",), "rad/s": ("speed",), "m/s": ("speed",), "m": ("angle",)}
UNITS |= {"N": ("force", "voltage")}  # for a force may be called u
SUBSCRIPT = r"([sr]?(alph|bet|al|be)\w*|[sr]?[abcdquvw]?\d?)"
KINDS = (
    (r"t|\w*time\w*|zeit\w*|\w*clock\w*|seconds?|t\w?sec", "time"),
    (r"(position|pos|encoder|phi)\w*|\w*(angle|theta)\w*|winkel\w*", "angle"),
    (r"(w[emr]?|n|rpm)\d*|\w*(omega|speed|velocity|drehzahl)\w*", "speed"),
    (r"(psi|lambda)\w*|\w*flux\w*", "flux"),
    (rf"\w*volt\w*|spannung\w*|[uv]{SUBSCRIPT}n?", "voltage"),
    (rf"\w*(current|amp)\w*|strom\w*|i{SUBSCRIPT}", "current"),
    (r"\w*(torque|force)\w*|moment\w*", "force"),
)


def plain(name: str) -> str:
    """A name without capitals, blanks and signs, Greek letters spelt out."""
    for letter, word in GREEK.items():
        name = name.replace(letter, word)
    return "".join(c for c in name.lower() if c.isalnum())


def others(name: str) -> set[str]:
    """What others call our column `name`, [`plain`][]."""
    if name in OTHERS:
        return OTHERS[name]
    beginning, _, end = name.rpartition("_")
    if beginning in BEGINNINGS and end in ENDINGS:
        return {b + e for b, e in product(BEGINNINGS[beginning], ENDINGS[end])}
    return set()


def means(name: str, base: str, unit: str) -> bool:
    """Whether a column that is called `base`, in `unit`, is our column `name`."""
    text = plain(base)
    if text in others(name):
        return True
    turning = unit.lower().replace(" ", "") in ("rpm", "1/min", "u/min", "min-1", "min^-1")
    return name == "omega_mechanical" and turning and text in TURNS


def kind(name: str) -> str:
    """The kind of quantity that a name stands for, empty where it does not tell."""
    text = plain(name)
    return next((k for pattern, k in KINDS if re.fullmatch(pattern, text)), "")


def kinds_of(name: str) -> set[str]:
    """The kinds of quantity that our column `name` may be, none where that is unknown."""
    return {kind for unit in units_of(name) for kind in UNITS.get(unit, ())}


def says(name: str, which: tuple[str, ...]) -> bool:
    """Whether the name of an angle says that it is electrical, or mechanical."""
    text = plain(name)
    return any(text in (a + w, w + a) for a in ANGLES for w in which)
