"""What is wrong with a log of a turning flux, from how well each hypothesis explains it."""

import math
from collections.abc import Sequence

from . import _trial as trial
from ._causes import causes as known_causes
from ._circle import Circle
from ._hypotheses import words
from ._sample import Chunk
from ._trial import Trial
from ._value import Diagnosis, Finding
from ._windows import Windows, turning_rate, windows_of

CLEAR = 3e-4  # a relative residual below which nothing is looked for
BETTER = 5.0  # times that a hypothesis must make the residual smaller
ALIKE = 2.0  # times the smallest residual, up to which others explain a log as well
UNEXPLAINED = 0.02  # a relative residual that is a warning of its own
OF_A_LOG, OF_A_MACHINE = 0.01, 0.03  # flux errors that are worth a warning
RADIUS = math.log(1.15)  # a magnet that is off by less does no harm
DOUBT = 0.1  # of a parameter: an error that is likely in a right log
ARC = 1.5  # rad that the flux must turn in a window


def of_circle(chunks: Sequence[Chunk], circle: Circle) -> Diagnosis:
    """The verdict on the chunks of a log."""
    windows = _windows(chunks, circle)
    if windows is None:
        note = f"{circle.quantity}: too little turning to check the log against its model"
        return Diagnosis(notes=(note,))
    tried = trial.trials(windows, circle, known_causes(circle), CLEAR)
    nominal, others = tried[0], [t for t in tried[1:] if _possible(t, circle)]
    figures = {
        "residual": nominal.residual,
        "noise": nominal.noise,
        "radius": nominal.radius,
    }
    if nominal.residual < CLEAR and _near(nominal, circle):
        return Diagnosis(figures=figures)
    best = min(others, key=lambda t: t.cost)
    if best.cost > nominal.cost / BETTER:
        return Diagnosis(_unexplained(nominal, best, circle), figures)
    explained = [t for t in others if t.cost <= nominal.cost / BETTER]
    rivals = _plain([t for t in explained if t.cost <= ALIKE * best.cost + 1e-4])
    figures["flux_error"] = max(t.flux_error for t in rivals)
    doubtful = [t for t in explained if abs(_changed(t, circle) - 1.0) < DOUBT]
    if any(_harmless(t, circle) for t in (*rivals, *doubtful)):
        return Diagnosis(figures=figures)
    return Diagnosis((_warning(nominal, rivals, circle),), figures)


def _windows(chunks: Sequence[Chunk], circle: Circle) -> Windows | None:
    """Windows in which the flux turns, as far as the log as it is can tell."""
    windows = windows_of(chunks, circle, turning_rate(chunks, circle))
    if windows is None:
        return None
    turning = trial.arcs(windows, circle) >= ARC
    return windows.only(turning) if turning.any() else None


def _plain(rivals: Sequence[Trial]) -> list[Trial]:
    """The likelier of those that explain a log alike: one of each kind, those with a fitted
    scale only where there is no named one."""
    by = lambda t: (-t.tried.plain, t.cost)
    kinds: dict[str, Trial] = {}
    for t in sorted(rivals, key=by):
        kinds.setdefault(t.tried.kind, t)
    found = list(kinds.values())
    named = [t for t in found if t.tried.plain > 1]
    return named or found


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
    return math.isfinite(t.cost) and _changed(t, circle) > 0.0


def _near(t: Trial, circle: Circle) -> bool:
    """Whether the radius that fits is about the one that is given, if one is."""
    if circle.radius is None:
        return True
    return abs(math.log(t.radius / circle.radius)) < RADIUS


def _warning(nominal: Trial, rivals: Sequence[Trial], circle: Circle) -> Finding:
    shown = rivals[:3]
    causes = ", or ".join(_cause(t, circle) for t in shown)
    remedies = [t.tried.remedy.format(**words(circle)) for t in shown]
    remedy = "; or ".join(dict.fromkeys(filter(None, remedies)))
    better = _times(nominal.cost / max(min(t.cost for t in shown), 1e-12))
    harm = 100 * shown[0].flux_error
    told = f"the {circle.quantity} is off by about {harm:.3g} %, " if harm >= 0.1 else ""
    message = f"{causes}: {told}and the log fits {better} better without that; {remedy}"
    return Finding(shown[0].tried.kind, message)


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
    ua, ub, ia, ib = circle.symbols
    i = b / circle.resistance
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
