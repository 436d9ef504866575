"""What a verdict says of hypotheses, in words."""

import math
from collections.abc import Sequence

from ._circle import Circle
from ._hypotheses import words
from ._trial import Trial
from ._value import Finding

SHOWN = 3  # causes that a message names


def warning(times: float, rivals: Sequence[Trial], circle: Circle) -> Finding:
    shown = rivals[:SHOWN]
    causes = ", or ".join(cause_of(t, circle) for t in shown)
    remedies = [t.tried.remedy.format(**words(circle)) for t in shown]
    remedy = "; or ".join(dict.fromkeys(filter(None, remedies)))
    harm = 100 * shown[0].flux_error
    told = f"the {circle.quantity} is off by about {harm:.3g} %, " if harm >= 0.1 else ""
    fits = f"the log fits {_times(times)} better without that"
    return Finding(shown[0].tried.kind, f"{causes}: {told}and {fits}; {remedy}")


def better_than(nominal: Trial, rivals: Sequence[Trial]) -> float:
    """How many times the log as it is fits worse than under the best of what is shown."""
    return nominal.cost / max(min(t.cost for t in rivals[:SHOWN]), 1e-12)


def _times(x: float) -> str:
    return f"{x:.2g} times" if x < 100 else "over 100 times"


def cause_of(t: Trial, circle: Circle) -> str:
    h, names = t.tried, words(circle)
    value = t.values[0] if t.values else 0.0
    fitted = {
        "voltage_scale": lambda: _how_large(1.0 / (1.0 + value)),
        "current_scale": lambda: _how_large(1.0 / (1.0 + value)),
        "offset": lambda: _offset(complex(*t.values), circle),
        "resistance": lambda: circle.resistance + value,
        "inductance": lambda: circle.inductance + value,
        "radius": lambda: t.radius,
    }
    shown = fitted[h.kind]() if h.kind in fitted else value
    return h.cause.format(shown, **names)


def _how_large(factor: float) -> str:
    if factor < 0:
        return f"{abs(factor):.4g} times what they should be, with the wrong sign,"
    large = factor >= 1.0
    size = factor if large else 1.0 / factor
    return f"{size:.4g} times too {'large' if large else 'small'}"


def _offset(b: complex, circle: Circle) -> str:
    """In words: `b` (V) is what the voltages lack; a current that is too large by what `b`
    drives through the resistance looks the same."""
    i = b / circle.resistance
    named = words(circle)
    names = (named["ud"], named["uq"]), (named["id"], named["iq"])
    if circle.frame != "alpha-beta":
        names = ("alpha", "beta"), ("alpha", "beta")
    (ua, ub), (ia, ib) = names
    return (
        f"of the currents, {i.real:.3g} A of {ia} and {i.imag:.3g} A of {ib}, or of the "
        f"voltages, {-b.real:.3g} V of {ua} and {-b.imag:.3g} V of {ub}"
    )


def either(
    alike: Sequence[Trial], nominal: Trial, circle: Circle, even: bool = True
) -> Finding:
    """What is said where the magnet flux is off, unless the voltages are of other rows; in
    a log that is not `even`, more than the magnet flux is."""
    causes = ", or ".join(cause_of(t, circle) for t in alike)
    harms = " or ".join(f"{100 * t.flux_error:.2g} %" for t in alike)
    remedies = "; or ".join(t.tried.remedy for t in alike)
    ratio = nominal.radius / (circle.radius or nominal.radius)
    if not even:
        times = _times(better_than(nominal, alike))
        return Finding(
            alike[0].tried.kind,
            f"{causes}: the {circle.quantity} is off by about {harms}, and the log fits "
            f"{times} better without that; {remedies}; or record a step of the load, which "
            "tells them apart",
        )
    return Finding(
        alike[0].tried.kind,
        f"{causes}, or the {circle.radius_name} is {ratio:.4g} times the one given; at a "
        f"speed and a current that are constant they look alike. The {circle.quantity} is "
        f"off by about {harms}, or right if it is the {circle.radius_name}; {remedies}; "
        "or record a step of the load, which tells them apart",
    )


def changed(t: Trial, circle: Circle) -> float:
    """The factor of the parameter that a hypothesis fits; infinite where it fits none."""
    given = {"resistance": circle.resistance, "inductance": circle.inductance}
    if t.tried.kind == "radius" and circle.radius is not None:
        return t.radius / circle.radius
    if t.tried.kind in given:
        return 1.0 + t.values[0] / given[t.tried.kind]
    return math.inf


def off(t: Trial, circle: Circle) -> float:
    """By how much a hypothesis has a parameter off, the logarithm of the factor; zero where
    it fits none."""
    factor = changed(t, circle)
    return abs(math.log(factor)) if math.isfinite(factor) else 0.0
