"""What is wrong with a log of a turning flux, from how well each hypothesis explains it."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from . import _rotations as rotations, _trial as trial
from ._causes import causes as known_causes
from ._circle import Circle
from ._even import HARM, timing
from ._level import BETTER, CLEAR, is_even, is_usual, of_level
from ._sample import Chunk
from ._trial import Trial
from ._value import Diagnosis, Finding
from ._windows import Windows, turning_rate, windows_of
from ._wording import better_than, cause_of, changed, either, off, warning

ALIKE = 2.0  # times the smallest residual, up to which others explain a log as well
FITS = 0.01  # a relative residual of a hypothesis that is believed by itself
AXES = 1e-3  # a relative residual below which no frame is wrong
UNEXPLAINED = 0.02  # a relative residual that is a warning of its own
OF_A_LOG, OF_A_MACHINE = 0.01, 0.03  # flux errors that are worth a warning
RADIUS = math.log(1.15)  # a magnet that is off by less does no harm
TOLD = math.log(1.1)  # the same in a log that tells nothing else: what magnets vary by
DOUBT = 0.1  # of a parameter: an error that is likely in a right log
LIKELY = math.log(1.5)  # of a parameter: one that is further off is not so by itself
EXCUSE = math.log(1.2)  # the same, where the timing of the voltages may be wrong instead
ABSURD = math.log(3.0)  # of a parameter: others come first
LIGHT, DRIVEN = 5e-4, 0.02  # of the flux: what a current, and a voltage, does at least
FLOOR = 0.2  # of the noise: what a residual below it is, is chance
LEVEL = math.log(1.03)  # of the radius: worth a note
BESIDE = 30.0  # degrees: a magnet that is as far from its d axis is worth a warning


def of_circle(
    chunks: Sequence[Chunk], circle: Circle, turning: Sequence[Chunk] = ()
) -> Diagnosis:
    """The verdict on the chunks of a log; `turning`: those of a log in dq, as they were
    read, which an angle that is wrong may have made look wrong everywhere."""
    found, nominal = _of_flux(chunks, circle, turning)
    if found.warnings or nominal is None or not turning:
        return found
    return found + _of_axis(circle, nominal)


def _of_flux(
    chunks: Sequence[Chunk], circle: Circle, turning: Sequence[Chunk]
) -> tuple[Diagnosis, Trial | None]:
    """The verdict by the length of the flux, and the trial of the log as it is."""
    windows = _windows(chunks, circle)
    if windows is None and turning:
        found = [t for t in _turned(turning, circle) if t.cost < FITS]
        if found:
            best = min(found, key=lambda t: t.cost)
            rivals = _plain(
                [t for t in found if t.cost <= ALIKE * best.cost + 1e-4], circle
            )
            return Diagnosis((warning(math.inf, rivals, circle),)), None
    if windows is None:
        note = f"{circle.quantity}: too little turning to check the log against its model"
        return Diagnosis(notes=(note,)), None
    tried = trial.trials(windows, circle, known_causes(circle), CLEAR)
    nominal, others = tried[0], [t for t in tried[1:] if _possible(t, circle)]
    if turning and nominal.cost > AXES:
        others += _turned(turning, circle)
    figures = {
        "residual": nominal.residual,
        "noise": nominal.noise,
        "radius": nominal.radius,
    }
    direction = _of_direction(turning, circle, nominal) if turning else None
    if direction is not None:
        return Diagnosis((direction,), figures), nominal
    if nominal.residual < CLEAR and _near(nominal, circle):
        return _quiet(windows, nominal, chunks, circle, figures), nominal
    if is_even(nominal, others, circle, windows.drift):
        if _near(nominal, circle, TOLD):
            return _quiet(windows, nominal, chunks, circle, figures), nominal
        found = of_level(nominal, others, circle, windows.drift)
        return Diagnosis((found,), figures), nominal
    best = min(others, key=lambda t: t.cost)
    least = max(best.cost, FLOOR * nominal.noise)
    if least > nominal.cost / BETTER:
        found = _unexplained(nominal, best, circle)
        if found:
            return Diagnosis(found, figures), nominal
        return _quiet(windows, nominal, chunks, circle, figures), nominal
    explained = [t for t in others if t.cost <= nominal.cost / BETTER]
    alike = CLEAR if turning else 1e-4
    rivals = [t for t in explained if t.cost <= ALIKE * least + alike]
    rivals = _plain([*rivals, *_named_scales(rivals, explained)], circle)
    doubtful = [t for t in explained if abs(changed(t, circle) - 1.0) < DOUBT]
    axes = [t for t in rivals if t.tried.angle is not None and rotations.aligned(t)]
    if axes and not rotations.aligned(nominal):  # that tells more than lengths do
        rivals, doubtful = axes, []
    figures["flux_error"] = max(t.flux_error for t in rivals)
    if _pardoned(rivals, doubtful, circle):
        return _quiet(windows, nominal, chunks, circle, figures), nominal
    found = warning(better_than(nominal, rivals), rivals, circle)
    return Diagnosis((found,), figures), nominal


def _turned(chunks: Sequence[Chunk], circle: Circle) -> list[Trial]:
    """What may be wrong with a log in dq and its angle."""
    hypotheses = rotations.rotations(circle, chunks)
    found = rotations.tried(chunks, circle, hypotheses)
    return [t for t in found if _possible(t, circle)]


def _of_direction(
    chunks: Sequence[Chunk], circle: Circle, nominal: Trial
) -> Finding | None:
    """What is wrong with a log in dq whose magnet is beside the d axis, and along it with
    other components or another direction of the angle: at constant speed and current
    lengths tell little."""
    if abs(nominal.lead) < rotations.STEADY or rotations.aligned(nominal):
        return None
    found = rotations.tried(chunks, circle, rotations.directions())
    found = [t for t in found if rotations.aligned(t) and _possible(t, circle)]
    best = min(found, key=lambda t: t.cost, default=None)
    if best is None or best.cost > min(nominal.cost, FITS):
        return None
    rivals = _plain([t for t in found if t.cost <= ALIKE * best.cost + CLEAR], circle)
    return warning(better_than(nominal, rivals), rivals, circle)


def _of_axis(circle: Circle, nominal: Trial) -> Diagnosis:
    """Where the magnet is beside the d axis of a log in dq that fits its model."""
    if abs(nominal.lead) < rotations.STEADY or rotations.aligned(nominal):
        return Diagnosis()
    degrees = np.degrees(np.angle(nominal.lead))
    said = (
        f"the magnet is {degrees:.3g} degrees ahead of the d axis, by the angle "
        f"`{circle.angle}`: that has another zero, or d and q another convention"
    )
    if abs(degrees) < BESIDE:
        return Diagnosis(notes=(said,))
    right = (
        f"where d and q were made with it the {circle.quantity} is right all the same; "
        "check the zero of the angle"
    )
    return Diagnosis((Finding("angle_offset", f"{said}; {right}"),))


def _windows(chunks: Sequence[Chunk], circle: Circle) -> Windows | None:
    """Windows in which the flux turns, as far as the log as it is can tell."""
    windows = windows_of(chunks, circle, turning_rate(chunks, circle))
    if windows is None:
        return None
    turning = trial.arcs(windows, circle) >= trial.ARC
    return windows.only(turning) if turning.any() else None


def _named_scales(rivals: Sequence[Trial], explained: Sequence[Trial]) -> list[Trial]:
    """Those of a wrong sign where a fitted scale of the currents comes near it: the scale
    may make up for something else, such as the timing of the voltages."""
    fitted = [t.values[0] for t in rivals if t.tried.kind == "current_scale"]
    if any(abs(1.0 + value + 1.0) < DOUBT for value in fitted):
        return [t for t in explained if t.tried.kind == "sign"]
    return []


def _plain(rivals: Sequence[Trial], circle: Circle) -> list[Trial]:
    """The likelier of those that explain a log alike: one of each kind, those with a fitted
    scale only where there is none but parameters that are off by an unlikely factor."""
    plain = lambda t: 0 if off(t, circle) > ABSURD else t.tried.plain
    by = lambda t: (-plain(t), t.cost)
    kinds: dict[str, Trial] = {}
    for t in sorted(rivals, key=by):
        kinds.setdefault(t.tried.kind, t)
    found = list(kinds.values())
    if any(rotations.aligned(t) for t in found if t.tried.angle is not None):
        found = [t for t in found if t.tried.angle is None or rotations.aligned(t)]
    named = [t for t in found if plain(t) > 1]
    if all(off(t, circle) > LIKELY for t in named):
        return found
    if all(t.tried.kind == "resistance" for t in named):
        # Where the inductance matters little, currents of a usual scale look the same.
        named += [t for t in found if t.tried.kind == "current_scale" and is_usual(t)]
    return named


def _pardoned(rivals: Sequence[Trial], doubtful: Sequence[Trial], circle: Circle) -> bool:
    """Whether nothing is said of a log: all that may be wrong does no harm, or some of it
    does none and is likely. At constant speed another inductance, whatever it would have to
    be, makes up for many things that do harm; and a resistance makes up for voltages of
    other rows, which are common, so that it excuses them only where it is very likely."""
    if all(_harmless(t, circle) for t in rivals):
        return True
    late = any(t.tried.shift and t.flux_error > HARM for t in rivals)
    limit = lambda t: EXCUSE if late and t.tried.kind != "radius" else LIKELY
    likely = lambda t: off(t, circle) < limit(t)
    return any(_harmless(t, circle) and likely(t) for t in (*rivals, *doubtful))


def _level(nominal: Trial, circle: Circle) -> tuple[str, ...]:
    """What is said of a log in which nothing but the level of the magnet flux is odd."""
    if circle.radius is None or not nominal.radius > 0:
        return ()
    ratio = nominal.radius / circle.radius
    if abs(math.log(ratio)) < LEVEL:
        return ()
    return (
        f"{circle.quantity}: the {circle.radius_name} that fits the log is {ratio:.3g} "
        "times the one given; where speed and current are constant, a wrong resistance, "
        "sign, scale or timing of the voltage would look the same, and another speed or "
        "current in the same log would tell them apart",
    )


def _quiet(
    windows: Windows,
    nominal: Trial,
    chunks: Sequence[Chunk],
    circle: Circle,
    figures: Mapping[str, float],
) -> Diagnosis:
    """What is said of a log that fits its model: of the timing of its voltages, and of the
    level of its magnet."""
    found = timing(windows, nominal, chunks, circle, CLEAR, RADIUS)
    wrong = [t for t in (found.told, *found.alike[:1]) if t is not None]
    if not wrong:
        return Diagnosis(figures=figures, notes=_level(nominal, circle) + found.notes)
    figures = {**figures, "flux_error": wrong[0].flux_error}
    if found.told is not None:
        return Diagnosis((warning(found.better, wrong, circle),), figures)
    return Diagnosis((either(found.alike, nominal, circle, found.even),), figures)


def _harmless(t: Trial, circle: Circle) -> bool:
    """Whether a log that is wrong in this way still gives a flux that is right."""
    if t.tried.kind == "radius":
        return _near(t, circle)
    limit = OF_A_LOG if t.tried.of == "log" else OF_A_MACHINE
    return t.flux_error < limit


def _possible(t: Trial, circle: Circle) -> bool:
    if t.tried.kind in ("voltage_scale", "current_scale") and abs(1.0 + t.values[0]) < 1e-9:
        return False  # a signal that is to be nothing explains nothing
    if t.tried.kind in ("current_unit", "current_scale") and t.load < LIGHT:
        return False
    if t.tried.kind in ("voltage_unit", "voltage_scale") and t.drive < DRIVEN:
        return False
    return math.isfinite(t.cost) and changed(t, circle) > 0.0


def _near(t: Trial, circle: Circle, bound: float = RADIUS) -> bool:
    """Whether the radius that fits is about the one that is given, if one is."""
    if circle.radius is None:
        return True
    return abs(math.log(t.radius / circle.radius)) < bound


def _unexplained(nominal: Trial, best: Trial, circle: Circle) -> tuple[Finding, ...]:
    odd = nominal.residual
    if circle.radius is not None:
        odd = max(odd, abs(math.log(nominal.radius / circle.radius)) / 5.0)
    if odd < UNEXPLAINED:
        return ()
    return (
        Finding(
            "inconsistent",
            f"the log does not fit its model: |flux - L i| varies by "
            f"{100 * nominal.residual:.2g} % where it must not, and no single cause was "
            f"found (the nearest: {cause_of(best, circle)}); check units, signs, axes and "
            "parameters one by one",
        ),
    )
