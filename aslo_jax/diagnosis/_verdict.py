"""What is wrong with a log of a turning flux, from how well each hypothesis explains it."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from . import _rotations as rotations, _trial as trial
from ._causes import causes as known_causes
from ._circle import Circle
from ._even import HARM, timing
from ._hypotheses import words
from ._sample import Chunk
from ._trial import Trial
from ._value import Diagnosis, Finding
from ._windows import Windows, turning_rate, windows_of

CLEAR = 3e-4  # a relative residual below which nothing is looked for
BETTER = 5.0  # times that a hypothesis must make the residual smaller
ALIKE = 2.0  # times the smallest residual, up to which others explain a log as well
FITS = 0.01  # a relative residual of a hypothesis that is believed by itself
AXES = 1e-3  # a relative residual below which no frame is wrong
UNEXPLAINED = 0.02  # a relative residual that is a warning of its own
OF_A_LOG, OF_A_MACHINE = 0.01, 0.03  # flux errors that are worth a warning
RADIUS = math.log(1.15)  # a magnet that is off by less does no harm
DOUBT = 0.1  # of a parameter: an error that is likely in a right log
LIKELY = math.log(1.5)  # of a parameter: one that is further off is not so by itself
EXCUSE = math.log(1.2)  # the same, where the timing of the voltages may be wrong instead
ABSURD = math.log(3.0)  # of a parameter: others come first
FLOOR = 0.2  # of the noise: what a residual below it is, is chance
SHOWN = 3  # causes that a message names
LEVEL = math.log(1.03)  # of the radius: worth a note


def of_circle(
    chunks: Sequence[Chunk], circle: Circle, turning: Sequence[Chunk] = ()
) -> Diagnosis:
    """The verdict on the chunks of a log; `turning`: those of a log in dq, as they were
    read, which an angle that is wrong may have made look wrong everywhere."""
    found, nominal = _of_flux(chunks, circle, turning)
    if found.warnings or nominal is None or not turning:
        return found
    return found + _of_axis(turning, circle, nominal)


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
            return Diagnosis((_warning(math.inf, rivals, circle),)), None
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
    if nominal.residual < CLEAR and _near(nominal, circle):
        return _quiet(windows, nominal, chunks, circle, figures), nominal
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
    doubtful = [t for t in explained if abs(_changed(t, circle) - 1.0) < DOUBT]
    axes = [t for t in rivals if t.tried.angle is not None and rotations.aligned(t)]
    if axes and not rotations.aligned(nominal):  # that tells more than lengths do
        rivals, doubtful = axes, []
    figures["flux_error"] = max(t.flux_error for t in rivals)
    if _pardoned(rivals, doubtful, circle):
        return _quiet(windows, nominal, chunks, circle, figures), nominal
    warning = _warning(_better(nominal, rivals), rivals, circle)
    return Diagnosis((warning,), figures), nominal


def _turned(chunks: Sequence[Chunk], circle: Circle) -> list[Trial]:
    """What may be wrong with a log in dq and its angle."""
    hypotheses = rotations.rotations(circle, chunks)
    found = rotations.tried(chunks, circle, hypotheses)
    return [t for t in found if _possible(t, circle)]


def _of_axis(chunks: Sequence[Chunk], circle: Circle, nominal: Trial) -> Diagnosis:
    """Where the magnet is beside the d axis of a log in dq: at constant speed and current
    the length of the flux tells little."""
    if abs(nominal.lead) < rotations.STEADY or rotations.aligned(nominal):
        return Diagnosis()
    both = (rotations.REVERSED, rotations.BOTH_SWAPPED)
    others = [t for t in rotations.tried(chunks, circle, both) if rotations.aligned(t)]
    best = min(others, key=lambda t: t.cost, default=None)
    if best is not None and best.cost <= nominal.cost:
        return Diagnosis((_warning(_better(nominal, [best]), [best], circle),))
    degrees = np.degrees(np.angle(nominal.lead))
    note = (
        f"the magnet is {degrees:.3g} degrees ahead of the d axis, by the angle "
        f"`{circle.angle}`: that has another zero, or d and q another convention"
    )
    return Diagnosis(notes=(note,))


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
    plain = lambda t: 0 if _off(t, circle) > ABSURD else t.tried.plain
    by = lambda t: (-plain(t), t.cost)
    kinds: dict[str, Trial] = {}
    for t in sorted(rivals, key=by):
        kinds.setdefault(t.tried.kind, t)
    found = list(kinds.values())
    if any(rotations.aligned(t) for t in found if t.tried.angle is not None):
        found = [t for t in found if t.tried.angle is None or rotations.aligned(t)]
    named = [t for t in found if plain(t) > 1]
    if all(_off(t, circle) > LIKELY for t in named):
        return found
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
    likely = lambda t: _off(t, circle) < limit(t)
    return any(_harmless(t, circle) and likely(t) for t in (*rivals, *doubtful))


def _off(t: Trial, circle: Circle) -> float:
    """By how much a hypothesis has a parameter off, the logarithm of the factor; zero where
    it fits none."""
    factor = _changed(t, circle)
    return abs(math.log(factor)) if math.isfinite(factor) else 0.0


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
        "sign, scale or timing of the voltage would look the same",
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
        return Diagnosis((_warning(found.better, wrong, circle),), figures)
    return Diagnosis((_either(found.alike, nominal, circle),), figures)


def _either(alike: Sequence[Trial], nominal: Trial, circle: Circle) -> Finding:
    """What is said where the magnet flux is off, unless the voltages are of other rows."""
    causes = ", or ".join(_cause(t, circle) for t in alike)
    harms = " or ".join(f"{100 * t.flux_error:.2g} %" for t in alike)
    remedies = "; or ".join(t.tried.remedy for t in alike)
    ratio = nominal.radius / (circle.radius or nominal.radius)
    return Finding(
        alike[0].tried.kind,
        f"{causes}, or the {circle.radius_name} is {ratio:.4g} times the one given; at a "
        f"speed and a current that are constant they look alike. The {circle.quantity} is "
        f"off by about {harms}, or right if it is the {circle.radius_name}; {remedies}",
    )


def _harmless(t: Trial, circle: Circle) -> bool:
    """Whether a log that is wrong in this way still gives a flux that is right."""
    if t.tried.kind == "radius":
        return _near(t, circle)
    limit = OF_A_LOG if t.tried.of == "log" else OF_A_MACHINE
    return t.flux_error < limit


def _changed(t: Trial, circle: Circle) -> float:
    """The factor of the parameter that a hypothesis fits; infinite where it fits none."""
    given = {"resistance": circle.resistance, "inductance": circle.inductance}
    if t.tried.kind == "radius" and circle.radius is not None:
        return t.radius / circle.radius
    if t.tried.kind in given:
        return 1.0 + t.values[0] / given[t.tried.kind]
    return math.inf


def _possible(t: Trial, circle: Circle) -> bool:
    if t.tried.kind in ("voltage_scale", "current_scale") and abs(1.0 + t.values[0]) < 1e-9:
        return False  # a signal that is to be nothing explains nothing
    return math.isfinite(t.cost) and _changed(t, circle) > 0.0


def _near(t: Trial, circle: Circle) -> bool:
    """Whether the radius that fits is about the one that is given, if one is."""
    if circle.radius is None:
        return True
    return abs(math.log(t.radius / circle.radius)) < RADIUS


def _warning(better: float, rivals: Sequence[Trial], circle: Circle) -> Finding:
    shown = rivals[:SHOWN]
    causes = ", or ".join(_cause(t, circle) for t in shown)
    remedies = [t.tried.remedy.format(**words(circle)) for t in shown]
    remedy = "; or ".join(dict.fromkeys(filter(None, remedies)))
    harm = 100 * shown[0].flux_error
    told = f"the {circle.quantity} is off by about {harm:.3g} %, " if harm >= 0.1 else ""
    fits = f"the log fits {_times(better)} better without that"
    return Finding(shown[0].tried.kind, f"{causes}: {told}and {fits}; {remedy}")


def _better(nominal: Trial, rivals: Sequence[Trial]) -> float:
    """How many times the log as it is fits worse than under the best of what is shown."""
    return nominal.cost / max(min(t.cost for t in rivals[:SHOWN]), 1e-12)


def _times(x: float) -> str:
    return f"{x:.2g} times" if x < 100 else "over 100 times"


def _cause(t: Trial, circle: Circle) -> str:
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


def _unexplained(nominal: Trial, best: Trial, circle: Circle) -> tuple[Finding, ...]:
    off = nominal.residual
    if circle.radius is not None:
        off = max(off, abs(math.log(nominal.radius / circle.radius)) / 5.0)
    if off < UNEXPLAINED:
        return ()
    return (
        Finding(
            "inconsistent",
            f"the log does not fit its model: |flux - L i| varies by "
            f"{100 * nominal.residual:.2g} % where it must not, and no single cause was "
            f"found (the nearest: {_cause(best, circle)}); check units, signs, axes and "
            "parameters one by one",
        ),
    )
