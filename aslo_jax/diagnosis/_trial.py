"""Every hypothesis tried on the windows of a log."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float

from . import _fitting as fitting
from ._circle import Circle
from ._hypotheses import Hypothesis, apply
from ._windows import Windows

CHANCE = 3e-3  # a relative residual: what noise makes of a cost at most
ARC = 1.5  # rad that the flux must turn in a window


@dataclasses.dataclass(frozen=True)
class Trial:
    """How well a hypothesis explains a log; `None` for the log as it is.

    - `cost`, `residual`, `noise`, relative to the radius; `radius` (Wb): the one that fits;
    - `values`: of the free parameters of the hypothesis;
    - `load`: what the current takes off the flux and links, and `drive`: what the voltage
      adds to it, relative, rms;
    - `lead`: of a log in dq, `exp(j a)` of the angle a by which the magnet is ahead of the
      d axis, in the mean, so that its length is 1 where that is constant;
    - `flux_error`: of an estimate that knows nothing of it, relative, rms.
    """

    hypothesis: Hypothesis | None
    cost: float
    residual: float
    noise: float
    radius: float
    values: tuple[float, ...]
    flux_error: float
    lead: complex = 0j
    load: float = 0.0
    drive: float = 0.0

    @property
    def tried(self) -> Hypothesis:
        """The hypothesis, where there is one."""
        assert self.hypothesis is not None
        return self.hypothesis


def trials(
    windows: Windows, circle: Circle, hypotheses: Sequence[Hypothesis], clear: float
) -> list[Trial]:
    """The log as it is, and then every hypothesis, unless the cost of the log as it is
    is below `clear`."""
    (nominal,), flux = _tried(windows, circle, [None], None)
    found = [nominal]
    if nominal.cost < clear:
        return found
    # With another radius, the one that is given is no measurement.
    free = dataclasses.replace(circle, radius=None)
    key = lambda h: (h.kind == "radius", len(h.free))
    for (other, _), group in itertools.groupby(sorted(hypotheses, key=key), key):
        more, _ = _tried(windows, free if other else circle, list(group), flux)
        found += more
    return found


def of_each(
    windows: Windows,
    circle: Circle,
    hypotheses: Sequence[Hypothesis],
    before: Windows | None = None,
) -> list[Trial]:
    """Hypotheses on windows of their own, and where flux errors are asked for, on the same
    rows as they were `before`."""
    flux = None
    if before is not None:
        _, flux = _tried(before, circle, [None], None)
    return _tried(windows, circle, hypotheses, flux)[0]


def arcs(windows: Windows, circle: Circle) -> Float[np.ndarray, " W"]:
    """By how much the flux less what the current links turns in each window (rad), if the
    log is as it should be."""
    same = Hypothesis("", "")
    g, y, basis, *_ = _changed(windows, circle, same)
    found = fitting.fit(
        g[None],
        basis[None],
        np.zeros((1, 0)),
        y[None],
        windows.radius,
        circle.radius,
        np.array([circle.saliency]),
    )
    # Windows of noise alone turn as well.
    jerk = np.mean(np.abs(g[:, 2:] - 2.0 * g[:, 1:-1] + g[:, :-2]) ** 2, axis=1) / 6.0
    moves = np.var(g, axis=1) > 25.0 * jerk
    return _arcs(found.centre[0], g) * moves


def _arcs(
    centre: Complex[np.ndarray, " W"], g: Complex[np.ndarray, "W n"]
) -> Float[np.ndarray, " W"]:
    return np.ptp(np.unwrap(np.angle(centre[:, None] + g), axis=1), axis=1)


def _tried(windows, circle, hypotheses, nominal):
    same = Hypothesis("", "")
    each = [same if h is None else h for h in hypotheses]
    g, y, basis, start, flux, flux_basis, load, drive, owner = ([] for _ in range(9))
    for k, h in enumerate(each):
        signals = _changed(windows, circle, h)
        for first in h.starts[: len(h.starts) if h.free else 1]:
            values = np.zeros(len(h.free))
            if h.free:
                # Resistance and inductance start at factors of their own.
                unit = {"resistance": circle.resistance, "inductance": circle.inductance}
                values[0] = first * unit.get(h.free[0], 1.0)
            owner.append(k)
            start.append(values)
            lists = (g, y, basis, flux, flux_basis, load, drive)
            for those, one in zip(lists, signals, strict=True):
                those.append(one)
    stack = np.stack
    found = fitting.fit(
        stack(g),
        stack(basis),
        stack(start),
        stack(y),
        windows.radius,
        circle.radius,
        circle.saliency * np.array([each[k].inductance for k in owner]),
    )
    trials = []
    owner = np.array(owner)
    mine = None
    for k, h in enumerate(hypotheses):
        rows = np.flatnonzero(owner == k)
        # At constant speed a scale has two values that fit; one of them may be negative.
        chance = min(3.0 * windows.drift / max(found.radius[rows].max(), 1e-300), CHANCE)
        alike = found.cost[rows] <= 2.0 * found.cost[rows].min() + 1e-4 + chance
        change = np.abs(found.values[rows]).sum(axis=1)
        if h and h.free and h.free[0] in ("voltage", "current"):
            factor = 1.0 + found.values[rows, 0]
            change = np.abs(np.log(np.maximum(np.abs(factor), 1e-12)))
            change = np.where(factor < 0.0, change + 1e12, change)
        best = rows[np.argmin(np.where(alike, change, np.inf))] if h and h.free else rows[0]
        phi = (
            found.centre[best][:, None]
            + flux[best]
            + np.einsum("p,pwn->wn", found.values[best], flux_basis[best])
        )
        mine = phi if nominal is None else nominal
        lead = 0j
        if windows.axis is not None:
            magnet = phi - circle.inductance * y[best]
            lead = magnet * windows.axis.conj()
            lead = complex(np.mean(lead / np.maximum(np.abs(lead), 1e-300)))
        scale = max(float(np.sqrt(np.mean(np.abs(phi) ** 2))), 1e-300)
        error = float(np.sqrt(np.mean(np.abs(phi - mine) ** 2)) / scale)
        # Signals that hardly move are on an arc of any circle.
        magnet = g[best] + np.einsum("p,pwn->wn", found.values[best], basis[best])
        still = h is not None and np.median(_arcs(found.centre[best], magnet)) < ARC
        taken = load[best] - load[best].mean(axis=1, keepdims=True)
        added = drive[best] - drive[best].mean(axis=1, keepdims=True)
        if h is not None and h.free == ("current",):
            taken = (1.0 + found.values[best, 0]) * taken
        if h is not None and h.free == ("voltage",):
            added = (1.0 + found.values[best, 0]) * added
        trials.append(
            Trial(
                h,
                float("inf" if still else found.cost[best]),
                float(found.residual[best]),
                float(found.noise[best]),
                float(found.radius[best]),
                tuple(map(float, found.values[best])),
                error,
                lead,
                float(np.sqrt(np.mean(np.abs(taken) ** 2))) / scale,
                float(np.sqrt(np.mean(np.abs(added) ** 2))) / scale,
            )
        )
    return trials, mine


def _changed(windows: Windows, circle: Circle, h: Hypothesis):
    """g and y of a hypothesis, what its free parameters add to g, both for the flux, and
    what the current takes off it and links, and what the voltage adds to it."""
    R, L = circle.resistance * h.resistance, circle.inductance * h.inductance
    voltage = windows.shifted[h.shift] if h.shift else windows.voltage
    voltage = apply(h.voltage, voltage)
    current, y = apply(h.current, windows.current), apply(h.current, windows.y)
    t = windows.t + 0j
    effects = {
        "resistance": (-current, -current),
        "inductance": (-y, 0.0 * y),
        "voltage": (voltage, voltage),
        "current": (-R * current - L * y, -R * current),
        "alpha": (t, t),
        "beta": (1j * t, 1j * t),
        "dead": (-windows.dead, -windows.dead),
    }
    none = np.zeros((0, *t.shape), complex)
    basis = np.stack([effects[f][0] for f in h.free]) if h.free else none
    on_flux = np.stack([effects[f][1] for f in h.free]) if h.free else none
    flux = voltage - R * current
    return flux - L * y, y, basis, flux, on_flux, R * current + L * y, voltage
