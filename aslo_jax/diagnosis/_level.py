"""Logs that tell one number, the level of the flux: those of constant speed and current."""

import math
from collections.abc import Sequence

from ._circle import Circle
from ._trial import Trial
from ._value import Finding
from ._wording import better_than, cause_of, changed, off, warning

CLEAR = 3e-4  # a relative residual below which nothing is looked for
BETTER = 5.0  # times that a hypothesis must make a residual smaller
CHANCE, MOST = 3.0, 5e-3  # times what noise does; a relative residual
ALIKE = 2.0  # times another residual, up to which a shape is as right
SHOWN = 6  # causes that a message names
LIKELY = math.log(2.1)  # of a parameter, or of a scale: one that is further off is not so
EXACT = 0.05  # of the logarithm of a radius: as near something that is wrong as a whole
SAME = 0.015  # relative: factors that are taken for one
# Factors that signals are mistaken by: power-invariant, peak and rms, peak and power-
# invariant, lines and phases, halves and thirds, and rad and degrees, Hz, rpm.
USUAL = (1.5**0.5, 2.0**0.5, 1.5, 3.0**0.5, 2.0, 3.0, math.pi, 2.0 * math.pi)
USUAL = (*USUAL, 30.0 / math.pi, 180.0 / math.pi)
FREE = ("resistance", "inductance", "radius")
SCALES = ("voltage_scale", "current_scale")
UNEVEN = ("offset", "dead_time")  # what no level makes up for
SINGLE = (*SCALES, "resistance", "inductance")


def is_even(nominal: Trial, others: Sequence[Trial], circle: Circle, drift: float) -> bool:
    """Whether a log tells nothing but a level: with another radius its shape is right, and
    as right with another scale or parameter, so that those causes that mend the level are
    all as good. `drift` (Wb): what noise makes of a flux."""
    radius = _radius(others)
    if radius is None or circle.radius is None:
        return False
    least = min(_shape(t, circle) for t in others if t.tried.kind != "offset")
    limit = max(ALIKE * least, chance(drift, circle))
    if _shape(radius, circle) > limit:
        return False
    told = [_shape(t, circle) for t in others if _uneven(t)]
    if _shape(radius, circle) > max(BETTER * min(told, default=math.inf), CLEAR):
        return False
    if nominal.cost <= ALIKE * max(radius.residual, limit):
        return True
    right = _right(nominal, others, circle, drift)
    return any(t.tried.kind in SINGLE for t in right)


def of_level(
    nominal: Trial, others: Sequence[Trial], circle: Circle, drift: float
) -> Finding:
    """What is said where only the level is odd: of the causes that make it much better,
    the likely ones."""
    right = _right(nominal, others, circle, drift)
    found = _likely(right, circle)
    radius = _radius(others)
    assert radius is not None
    if all(t.tried.kind in SCALES for t in found):  # a scale fits any level
        found = [*found, radius]
    if len(found) == 1:
        return warning(better_than(nominal, found), found, circle)
    fitted = {
        t.tried.kind for t in right if t.tried.kind in SINGLE and _positive(t, circle)
    }
    return _undecided(radius, found, circle, bool(fitted - {t.tried.kind for t in found}))


def _positive(t: Trial, circle: Circle) -> bool:
    scale = t.tried.kind in SCALES
    return t.values[0] > -1.0 if scale else changed(t, circle) > 0.0


def _radius(others: Sequence[Trial]) -> Trial | None:
    return next((t for t in others if t.tried.kind == "radius"), None)


def _right(
    nominal: Trial, others: Sequence[Trial], circle: Circle, drift: float
) -> list[Trial]:
    """Those that mend the level, and whose shape is as right as with another radius."""
    radius = _radius(others)
    known = 0.0 if radius is None else _shape(radius, circle)

    def right(t: Trial) -> bool:
        shape = ALIKE * max(known, chance(_gain(t) * drift, circle))
        return t.residual <= shape and t.cost <= max(nominal.cost / BETTER, shape)

    return [t for t in others if right(t)]


def _shape(t: Trial, circle: Circle) -> float:
    """A residual, relative to the larger of the radius that is given and the one that
    fits."""
    return t.residual * min(1.0, t.radius / (circle.radius or t.radius))


def _uneven(t: Trial) -> bool:
    """Whether it mends what no level makes up for: what turns the other way, too, and what
    a motion that is not even tells of the timing."""
    conjugate = t.tried.voltage[1] or t.tried.current[1]
    if t.tried.kind in UNEVEN or t.tried.shift:
        return True
    return t.tried.angle is None and bool(conjugate)


def chance(drift: float, circle: Circle) -> float:
    """A residual that noise of voltage and current makes, which the integral adds up. What
    is rough in a signal may also be true."""
    return max(CLEAR, min(CHANCE * drift / (circle.radius or math.inf), MOST))


def _gain(t: Trial) -> float:
    """By how much a hypothesis makes the voltages, and their noise, larger."""
    free = 1.0 + t.values[0] if t.tried.free == ("voltage",) else 1.0
    return abs(t.tried.voltage[0]) * abs(free)


def _likely(right: Sequence[Trial], circle: Circle) -> list[Trial]:
    """By how likely they are: what is wrong as a whole, parameters, scales."""
    level = lambda t: abs(math.log(t.radius / (circle.radius or t.radius)))
    whole = [t for t in right if not t.tried.free and level(t) < EXACT]
    whole = [t for t in whole if t.tried.kind != "radius"]
    whole = sorted(_of_each_kind(whole), key=lambda t: (-t.tried.plain, t.cost))
    fitted = [t for t in right if t.tried.kind in FREE and off(t, circle) < LIKELY]
    fitted.sort(key=lambda t: off(t, circle))
    scales = [t for t in right if t.tried.kind in SCALES and t.values[0] > -1.0]
    scales.sort(key=_size)
    usual = [t for t in scales if _size(t) < LIKELY or is_usual(t)]
    if whole or fitted:
        scales = usual
    if any(t.tried.kind.endswith("_unit") for t in whole):
        scales = []
    named = [_factor(t.tried.voltage[0]) for t in whole if t.tried.kind != "sign"]
    named += [_factor(t.tried.current[0]) for t in whole if t.tried.kind != "sign"]
    return [*whole, *fitted, *(t for t in scales if not _near(_size(t), named))]


def _of_each_kind(trials: Sequence[Trial]) -> list[Trial]:
    best: dict[str, Trial] = {}
    for t in sorted(trials, key=lambda t: (-t.tried.plain, t.cost)):
        best.setdefault(t.tried.kind, t)
    return list(best.values())


def _factor(change: complex | float) -> float:
    return abs(math.log(abs(change))) if abs(change) > 0.0 else 0.0


def _size(t: Trial) -> float:
    """By how much a scale is off: the logarithm of its factor."""
    return abs(math.log(1.0 + t.values[0]))


def is_usual(t: Trial) -> bool:
    """Whether a scale is one that signals are mistaken by."""
    return t.values[0] > -1.0 and _near(_size(t), [math.log(x) for x in USUAL])


def _near(size: float, others: Sequence[float]) -> bool:
    return any(abs(size - x) < SAME for x in others)


def _undecided(
    radius: Trial, found: Sequence[Trial], circle: Circle, others: bool
) -> Finding:
    shown = found[:SHOWN]
    causes = "; or ".join(cause_of(t, circle) for t in shown)
    rarer = others or len(found) > len(shown)
    more = "; or, less likely, another scale or parameter" if rarer else ""
    errors = [100.0 * t.flux_error for t in shown]
    least, most = min(errors), max(errors)
    spread = f"by up to {most:.2g} %" if least < 0.1 else f"by {least:.2g} to {most:.2g} %"
    ratio = radius.radius / (circle.radius or radius.radius)
    return Finding(
        "undecided",
        f"|flux - L i| is {ratio:.3g} times the {circle.radius_name} given, and nothing "
        f"else is odd, so that the log cannot tell why: {causes}{more}. The "
        f"{circle.quantity} is off {spread}, by which of them it is; record another speed "
        "or current in the same log, which tells them apart",
        candidates=tuple(t.tried.kind for t in found),
    )
