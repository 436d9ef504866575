"""The timing of the voltages of a log whose motion is so even that lengths tell little."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from . import _trial as trial
from ._causes import causes
from ._circle import Circle
from ._leaps import by_leaps
from ._level import chance
from ._sample import Chunk
from ._trial import Trial
from ._windows import Windows

CLEARLY = 3.0  # times that leaps must fit better under another timing, and lengths as well
TURN = 0.05  # rad a row: from here on the timing is worth a note
HARM = 0.03  # of the flux: an error that is worth a warning
EXACT = 2e-3  # of the radius: as near a right timing brings it to the one given
ODD = 0.01  # of the radius: less may be anything
LIKELY = 0.2  # of the resistance: an error that is likely
ALIKE = 2.0  # times the residual, up to which another timing is possible


@dataclasses.dataclass(frozen=True)
class Timing:
    """What may be wrong with the timing of a log in which nothing else is.

    - `told`: the timing that leaps of the voltage tell, and by how many times they then
      fit `better`;
    - `alike`: where they tell nothing, what makes up for a magnet flux that is off: a
      timing and, after it, a resistance, unless that is impossible; and whether the log is
      so `even` that the magnet flux makes up for it by itself;
    - `notes`: in words, where not even that is odd.
    """

    told: Trial | None = None
    better: float = 1.0
    alike: tuple[Trial, ...] = ()
    even: bool = True
    notes: tuple[str, ...] = ()


def timing(
    windows: Windows,
    nominal: Trial,
    chunks: Sequence[Chunk],
    circle: Circle,
    clear: float,
    near: float,
) -> Timing:
    """The timing of a log that, as it is, fits as well as `nominal`. Under another one its
    residual may be `clear` at least, and the logarithm of its radius `near`."""
    known = causes(circle)
    moved = [h for h in known if h.kind == "voltage_timing"]
    limit = max(ALIKE * nominal.residual, clear)
    tried = [
        t
        for t in trial.of_each(windows, circle, moved, windows)
        if t.residual < limit and _off(t, circle) < near
    ]
    leaps = by_leaps(chunks, circle)
    best = min(leaps, key=lambda shift: leaps[shift], default=0.0)
    if leaps and leaps[0.0] > CLEARLY * leaps[best]:
        for t in tried:
            fits = t.residual < max(nominal.residual, clear)
            if t.tried.shift == best and fits and t.flux_error > HARM:
                return Timing(t, leaps[0.0] / max(leaps[best], 1e-300))
    if leaps and all(x > ALIKE * leaps[0.0] for s, x in leaps.items() if s):
        return Timing()
    if leaps:  # what they speak against is none of the timings
        least = ALIKE * min(leaps.values())
        tried = [t for t in tried if leaps.get(t.tried.shift, math.inf) <= least]
    late = _instead_of_magnet(tried, nominal, circle)
    limit = chance(windows.drift, circle)
    even = nominal.residual < limit
    if late is not None and (even or _mends(late, nominal, limit)):
        (resistance,) = trial.of_each(
            windows, circle, [h for h in known if h.kind == "resistance"], windows
        )
        factor = 1.0 + resistance.values[0] / circle.resistance
        fits = factor > 0 and _off(resistance, circle) < ODD / 2.0
        if not fits or abs(factor - 1.0) > LIKELY:
            if not even:  # the magnet flux alone does not mend it, a resistance may
                fits = factor > 0 and resistance.residual <= ALIKE * late.residual
            return Timing(alike=(late, resistance) if fits else (late,), even=even)
    turn = windows.rate * windows.interval
    if turn < TURN or not any(abs(t.tried.shift) == 1.0 for t in tried):
        return Timing()
    note = (
        f"{circle.quantity}: speed and current are too even to tell the timing of the "
        f"voltages; a row late or early would turn the estimate by {np.degrees(turn):.2g} "
        "degrees. A step of the load or of the speed in the same log tells it"
    )
    return Timing(notes=(note,))


def _instead_of_magnet(
    tried: Sequence[Trial], nominal: Trial, circle: Circle
) -> Trial | None:
    """The row, late or early, under which the magnet flux is the one that is given, which
    it is not under the timing of the log. Two rows would fit by chance too often."""
    if circle.radius is None or _off(nominal, circle) < ODD:
        return None
    late = [t for t in tried if abs(t.tried.shift) == 1.0 and t.flux_error > HARM]
    return next((t for t in late if _fits(t, circle)), None)


def _mends(t: Trial, nominal: Trial, limit: float) -> bool:
    """Whether what is odd beside the level, too, is then what noise does, below `limit`. A
    timing that mends the level alone, where more is odd, does so by chance."""
    return t.residual < min(limit, nominal.residual / ALIKE)


def _fits(t: Trial, circle: Circle) -> bool:
    return _off(t, circle) < EXACT


def _off(t: Trial, circle: Circle) -> float:
    """The logarithm of the factor by which the radius that fits is off; 0 where none is
    given."""
    if circle.radius is None:
        return 0.0
    return abs(math.log(t.radius / circle.radius)) if t.radius > 0 else math.inf
