"""How fast, how far off, and how exact: the table of every observer in every experiment."""

from typing import NamedTuple

import numpy as np

from .._report import Table
from .._settled import settled, settled_text
from . import machines as m, pmsm, settings as s
from .runs import Runs


class Trace(NamedTuple):
    """The size of one estimate's error over the instants `t` (s), in `unit`; `scale`, the
    size of the quantity itself; `later` (s), when the start-up is over."""

    experiment: str
    observer: str
    quantity: str
    unit: str
    t: np.ndarray
    error: np.ndarray
    scale: float
    later: float

    def settled(self, fraction: float) -> float:
        """From when on the error stays below `fraction` of the scale (s), from the second
        instant on: no estimate exists at t = 0 yet."""
        return settled(self.t[1:], self.error[1:], fraction * self.scale)

    def peak(self, start: float, end: float = np.inf) -> float:
        """The largest error from `start` to `end` (s), both included."""
        within = (self.t > start - 1e-9) & (self.t < end + 1e-9)
        return float(self.error[within].max())

    @property
    def final(self) -> float:
        """The largest error over the last twentieth of the time."""
        return self.peak(self.t[-1] - 0.05 * (self.t[-1] - self.t[0]))


def size(run, name: str) -> np.ndarray:
    """The norm of the error of an observer of a simulation."""
    return np.linalg.norm(run.estimates[name].value - run.hidden, axis=-1)


def closed_loop(run) -> list[Trace]:
    """3.1.3, the paper's start and the exact one."""
    flux = ("flux", "Wb")
    return [
        Trace("PMSM, 3.1.3", name, *flux, np.asarray(run.t), size(run, name), s.MAGNET, 1.0)
        for name in (*pmsm.PAPER, *pmsm.EXACT)
    ]


def traces(runs: Runs) -> list[Trace]:
    """Every error of the section."""
    found = closed_loop(runs.closed)
    for name, error in runs.reversal.error.items():
        found.append(
            Trace(
                "PMSM, speed reversal with noise",
                f"ASLO exact, {name}",
                "flux",
                "Wb",
                runs.reversal.t,
                error,
                s.MAGNET,
                1.0,
            )
        )
    run = runs.shorted
    for name in run.estimates:
        winding, observer = name.split(", ", 1)
        scale = np.linalg.norm(run.hidden[:, m.WINDINGS[winding]], axis=1).max()
        error, quantity = m.winding_error(run, name), f"{winding} flux"
        found.append(
            Trace(
                "WRIM, shorted rotor",
                observer,
                quantity,
                "Wb",
                np.asarray(run.t),
                error,
                scale,
                1.0,
            )
        )
    for name, errors in (
        ("without the d current", runs.salient.dropped),
        ("self-consistent", runs.salient.consistent),
    ):
        for index in (0, len(m.RATIOS) // 2, len(m.RATIOS) - 1):
            worst = errors[index].max(axis=0)
            ratio = f"interior PMSM, Lq/Ld = {m.RATIOS[index]:g}, worst angle"
            found.append(
                Trace(ratio, name, "flux", "Wb", runs.salient.t, worst, s.MAGNET, 0.2)
            )
    run = runs.bearing
    parts = (
        ("fluxes", "Wb", slice(0, 2)),
        ("position", "m", slice(2, 3)),
        ("velocity", "m/s", slice(3, 4)),
    )
    for name in run.estimates:
        for quantity, unit, part in parts:
            error = np.linalg.norm(
                (run.estimates[name].value - run.hidden)[:, part], axis=1
            )
            scale = np.abs(run.hidden[:, part]).max()
            found.append(
                Trace(
                    "bearing", name, quantity, unit, np.asarray(run.t), error, scale, 0.02
                )
            )
    run = runs.stepper
    scale = float(np.linalg.norm(run.hidden, axis=1).max())
    for name in run.estimates:
        found.append(
            Trace(
                "stepper",
                name,
                "flux",
                "Wb",
                np.asarray(run.t),
                size(run, name),
                scale,
                1.0,
            )
        )
    return found


def table(runs: Runs) -> Table:
    """The table `settling`."""
    rows = [_row(trace) for trace in traces(runs)]
    caption = (
        "The size of the error of every observer in every experiment. *Settled* is the "
        "time from which it stays below 5 % and 0.1 % of the largest size of the quantity "
        "(of the magnet flux for a PMSM), 0 where it is below at every instant after t = "
        "0. *Peak* is the largest error at the saved instants of the two windows named "
        "beside it; a paper start passes a singularity in the first one, so that its peak "
        "there depends on the instants. *Final* is the largest error over the last "
        "twentieth of the time."
    )
    return Table("settling", "Section 3 of the paper: settling and peaks", caption, rows)


def _row(trace: Trace) -> dict[str, str]:
    first, last = float(trace.t[1]), float(trace.t[-1])

    def of(fraction):
        return settled_text(trace.t[1:], trace.error[1:], fraction * trace.scale)

    return {
        "experiment": trace.experiment,
        "observer": trace.observer,
        "quantity": trace.quantity,
        "unit": trace.unit,
        "size": f"{trace.scale:.3g}",
        "settled_5_percent_s": of(0.05),
        "settled_0.1_percent_s": of(1e-3),
        "start_up_window_s": f"{first:.3g} to {trace.later:.3g}",
        "start_up_peak": f"{trace.peak(first, trace.later):.3g}",
        "later_window_s": f"{trace.later:.3g} to {last:.3g}",
        "later_peak": f"{trace.peak(trace.later):.3g}",
        "final_error": f"{trace.final:.3g}",
    }
