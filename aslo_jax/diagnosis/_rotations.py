"""Hypotheses on a log in dq: the sign of its components, and its angle."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from . import _trial as trial
from ._circle import Circle
from ._hypotheses import SAME, Hypothesis, Map, apply, mapped
from ._sample import Chunk
from ._timing import moved
from ._trial import Trial
from ._windows import WINDOWS, Windows, turning_rate, windows_of

PAIRS = tuple(range(2, 13))  # pole pairs that an angle may count by
FLIPPED: Map = (0.0, 1.0)  # of a component: q, or -q; or d and q in each other's place
MIRRORED: Map = (0.0, -1.0)
SWAPPED: Map = (0.0, 1j)
AHEAD = np.radians(15.0)  # of the d axis: a magnet that is further is not along it
# Kinds of what is said of an angle, which every row depends on.
FRAMES = ("angle_sign", "angle_unit", "angle_kind", "pole_pairs", "dq_swapped")
LATE = 0.5  # rows: voltages of the instant
FEW = 6  # windows for a first look at every hypothesis, of which
LIKELIEST = 8  # are looked at with all
STEADY = 0.9  # the length of a mean direction that means something


def rotations(circle: Circle, chunks: Sequence[Chunk]) -> list[Hypothesis]:
    """What may be wrong with a log in dq, and may be told by rows of it."""
    turn = _turn_of(chunks, float(circle.pole_pairs or 1) if circle.mechanical else 1.0)
    return [*_components(), *_angles(circle, turn)]


def directions() -> list[Hypothesis]:
    """Those of them that put a magnet along the d axis which is not there."""
    return [REVERSED, *_components()]


def tried(
    chunks: Sequence[Chunk], circle: Circle, hypotheses: Sequence[Hypothesis]
) -> list[Trial]:
    """The trials of the likeliest hypotheses, with voltages that are held or with those of
    the instant. Each has windows of its own, as fast as the flux then turns."""
    if len(hypotheses) > LIKELIEST:
        costs = [_cost(chunks, circle, h) for h in hypotheses]
        best = np.argsort(costs)[:LIKELIEST]
        hypotheses = [hypotheses[k] for k in best if np.isfinite(costs[k])]
    found = []
    for h in hypotheses:
        windows = _windows(chunks, circle, h)
        if windows is None:
            continue
        before = windows_of(chunks, circle, windows.rate, (), dead=False)
        if before is None:
            continue
        turning = trial.arcs(windows, circle) >= trial.ARC
        if turning.any():
            windows, before = windows.only(turning), before.only(turning)
            each = trial.of_each(windows, circle, _timed(h), before)
            found += [dataclasses.replace(t, hypothesis=h) for t in each]
    return found


def _cost(chunks: Sequence[Chunk], circle: Circle, h: Hypothesis) -> float:
    """About how badly a hypothesis fits, by few windows."""
    windows = _windows(chunks, circle, h, FEW)
    if windows is None:
        return np.inf
    return min(t.cost for t in trial.of_each(windows, circle, _timed(h)))


def _windows(
    chunks: Sequence[Chunk], circle: Circle, h: Hypothesis, most: int = WINDOWS
) -> Windows | None:
    changed = [_rewritten(chunk, circle, h) for chunk in chunks]
    rate = turning_rate(changed, circle)
    return windows_of(changed, circle, rate, (LATE,), most, dead=False)


def _timed(h: Hypothesis) -> list[Hypothesis]:
    """A hypothesis whose maps are applied, for either timing of the voltage."""
    plain = dataclasses.replace(h, voltage=SAME, current=SAME, angle=None)
    return [plain, dataclasses.replace(plain, shift=LATE)]


def aligned(t: Trial) -> bool:
    """Whether the magnet is along the d axis."""
    return bool(abs(t.lead) > STEADY and abs(np.angle(t.lead)) < AHEAD)


def _rewritten(chunk: Chunk, circle: Circle, h: Hypothesis) -> Chunk:
    """A chunk as it would be under a hypothesis."""
    assert chunk.angle is not None and h.angle is not None
    u, y = chunk.u.copy(), chunk.y.copy()
    for x, pair, change, shift in (
        (u, circle.inputs, h.voltage, chunk.shift),
        (y, circle.outputs, h.current, 0.0),
    ):
        if max(pair) < x.shape[1]:
            was = moved(np.exp(1j * chunk.angle), shift)
            is_ = moved(np.exp(1j * h.angle * chunk.angle), shift)
            z = apply(change, (x[:, pair[0]] + 1j * x[:, pair[1]]) * was.conj()) * is_
            x[:, pair[0]], x[:, pair[1]] = np.real(z), np.imag(z)
    return dataclasses.replace(chunk, u=u, y=y, angle=h.angle * chunk.angle)


def _components() -> list[Hypothesis]:
    against = "of the {} has the other sign than that of the {}"
    found = []
    for signal, other, d, q, swap in (
        ("current", "voltages", "{id}", "{iq}", "{swap_i}"),
        ("voltage", "currents", "{ud}", "{uq}", "{swap_u}"),
    ):
        names = f"{signal}s"
        for kind, axis, column, change in (
            ("q_sign", "q", q, FLIPPED),
            ("d_sign", "d", d, MIRRORED),
        ):
            found.append(
                Hypothesis(
                    kind,
                    f"{axis} {against.format(names, other)}",
                    f"turn the sign of {column} in the log",
                    angle=1.0,
                    plain=3,
                    **mapped(signal, change),
                )
            )
        found.append(
            Hypothesis(
                "dq_swapped",
                f"d and q of the {names} are in each other's place",
                swap,
                angle=1.0,
                plain=3,
                **mapped(signal, SWAPPED),
            )
        )
    return [*found, BOTH_SWAPPED]


REVERSED = Hypothesis(
    "angle_sign",
    "the angle {angle} counts the other way round than d and q want it, or q has the other "
    "sign in voltages and currents",
    "turn the sign of {angle}, or of {uq} and {iq}, in the log",
    angle=-1.0,
    plain=4,
)
BOTH_SWAPPED = Hypothesis(
    "dq_swapped",
    "d and q are in each other's place, in voltages and currents",
    "{swap_u} {swap_i}",
    voltage=SWAPPED,
    current=SWAPPED,
    angle=1.0,
    plain=3,
)


def _angles(circle: Circle, turn: float | None) -> list[Hypothesis]:
    found = [REVERSED]
    p = circle.pole_pairs
    known = {p} if p else set()
    for pairs in sorted({*PAIRS, *known}):
        found += _counted(circle, float(pairs))
        found += _counted(circle, 1.0 / pairs)
    if circle.mechanical and p:
        found += [h for n in PAIRS if n % p for h in _counted(circle, n / p)]
    units = [
        (np.pi / 180.0, "in degrees, not in rad", "say so in its name, `[deg]`"),
        (2.0 * np.pi, "in turns, not in rad", "multiply it by 2 pi"),
    ]
    if turn is not None:
        what = f"in counts, {turn:.6g} a turn, not in rad"
        units.append((2.0 * np.pi / turn, what, f"multiply it by 2 pi/{turn:.6g}"))
    for factor, unit, remedy in units:
        for pairs in sorted({1, *known}):
            of = "" if pairs == 1 else ", and mechanical"
            and_kind = "" if pairs == 1 else "; and --angle-kind mechanical"
            if pairs > 1 and circle.mechanical:
                continue
            for sign in (1.0, -1.0):
                way = "" if sign > 0 else ", and counts the other way round"
                found.append(
                    Hypothesis(
                        "angle_unit",
                        f"the angle {{angle}} is {unit}{of}{way}",
                        remedy + and_kind + ("" if sign > 0 else "; and turn its sign"),
                        angle=sign * factor * pairs,
                        plain=4 if sign > 0 else 3,
                    )
                )
    return found


def _counted(circle: Circle, factor: float) -> Iterator[Hypothesis]:
    """The angle of other pole pairs, in both directions."""
    p = circle.pole_pairs
    kind, remedy = "pole_pairs", "check the number of pole pairs, and what the angle is of"
    cause = f"the angle {{angle}} goes {1.0 / factor:.4g} times as fast as the flux"
    if p and circle.mechanical and abs(factor * p - 1.0) < 1e-9:
        kind, remedy = "angle_kind", "--angle-kind electrical"
        cause = "the angle {angle} is the electrical one already"
    elif p and not circle.mechanical and factor == p:
        kind, remedy = "angle_kind", "--angle-kind mechanical"
        cause = "the angle {angle} is the mechanical one"
    elif p and circle.mechanical and abs(factor * p - round(factor * p)) < 1e-9:
        cause = f"the machine has {round(factor * p)} pole pairs rather than {p}"
        remedy = "mend `pole_pairs` of the machine"
    plain = 4 if kind == "angle_kind" else 3
    yield Hypothesis(kind, cause, remedy, angle=factor, plain=plain)
    yield Hypothesis(
        kind,
        f"{cause}, and it counts the other way round",
        f"{remedy}; and turn the sign of the angle",
        angle=-factor,
        plain=plain - 1,
    )


def _turn_of(chunks: Sequence[Chunk], scale: float) -> float | None:
    """What an angle, which was multiplied by `scale`, counts to before it begins again at
    zero, in its unit, if it does and that is no turn of radians or degrees."""
    jumps = [np.diff(chunk.angle) for chunk in chunks if chunk.angle is not None]
    steps: Any = np.concatenate(jumps) if jumps else np.zeros(0)
    steps = np.abs(steps[np.isfinite(steps)])
    if not steps.size or not steps.max() > 0.0:
        return None
    wraps = steps[steps > 0.5 * steps.max()]
    small = steps[steps <= 0.5 * steps.max()]
    if not small.size or wraps.size > 0.2 * steps.size:
        return None
    size = float(np.median(wraps) + np.median(small)) / scale
    bits = round(np.log2(max(size, 1.0)))
    if abs(size / 2.0**bits - 1.0) < 0.02 and bits >= 3:
        size = 2.0**bits
    elif wraps.size < 2:
        return None
    usual = (2.0 * np.pi, 360.0, 1.0)
    return None if any(abs(size / x - 1.0) < 0.02 for x in usual) else size
