"""Hypotheses on the phases of a log in abc."""

import numpy as np

from ._circle import PHASES as DIRECTIONS
from ._hypotheses import Hypothesis, Map, mapped, real_linear

PHASES = "check which phase is which, and map the columns with --column"
# Voltages between lines, in the order of their columns: the angle (degrees) by which they
# lead those of the phases, and what mends them, of the columns a and b.
LINES = (
    ("ab, bc and ca", 30, "a = (2 ab + bc)/3, b = (bc - ab)/3"),
    ("ac, ba and cb", -30, "a = (ac - ba)/3, b = (2 ba + ac)/3"),
    ("ca, ab and bc", 150, "a = (ab - ca)/3, b = -(2 ab + ca)/3"),
    ("ba, cb and ac", -150, "a = -(2 ba + cb)/3, b = (ba - cb)/3"),
    ("bc, ca and ab", -90, "a = -(bc + 2 ca)/3, b = (2 bc + ca)/3"),
    ("cb, ac and ba", 90, "a = (cb + 2 ac)/3, b = -(2 cb + ac)/3"),
)


def of_phases() -> list[Hypothesis]:
    """What may be wrong with the phases of a log."""
    found = [
        Hypothesis(
            "beta_flipped",
            "phases b and c of the currents are swapped against those of the voltages",
            PHASES,
            current=(0.0, 1.0),
            plain=4,
        ),
    ]
    for which, degrees in (("a and b", 120), ("a and c", -120)):
        found.append(
            Hypothesis(
                "phases_swapped",
                f"phases {which} of the currents are swapped against those of the voltages",
                PHASES,
                current=(0.0, np.exp(1j * np.radians(degrees))),
                plain=3,
            )
        )
    for degrees in (120, -120):
        found.append(
            Hypothesis(
                "axes_turned",
                f"the phases of the currents are on by one ({degrees} degrees) against "
                "those of the voltages",
                PHASES,
                current=(np.exp(-1j * np.radians(degrees)), 0.0),
                plain=3,
            )
        )
    return [*found, *_lines(), *_single()]


def _lines() -> list[Hypothesis]:
    return [
        Hypothesis(
            "line_voltages",
            f"{{u}} are the voltages between lines, {which}, not those of the phases",
            f"convert them: {remedy}",
            voltage=(np.exp(-1j * np.radians(degrees)) / np.sqrt(3.0), 0.0),
            plain=3,
        )
        for which, degrees, remedy in LINES
    ]


def _single() -> list[Hypothesis]:
    """One phase that is not there, or has the wrong sign."""
    found = []
    for k, phase in enumerate("abc"):
        for signal in ("voltage", "current"):
            for kind, factor, what, remedy in (
                ("phase_missing", 0.0, "is missing", "measure it, or leave {} out"),
                ("phase_sign", -1.0, "has the wrong sign", "turn its sign in the log"),
            ):
                column = f"column {phase} of the {signal}s"
                found.append(
                    Hypothesis(
                        kind,
                        f"phase {phase} of the {signal}s {what}",
                        remedy.format(column),
                        plain=3,
                        **mapped(signal, _undone(k, factor)),
                    )
                )
    return found


def _undone(phase: int, factor: float) -> Map:
    """What makes up for a phase that was multiplied by `factor`: of phases that sum to
    zero."""
    keep = np.ones(3)
    keep[phase] = factor
    of = lambda z: 2.0 / 3.0 * np.sum(keep * (z * DIRECTIONS.conj()).real * DIRECTIONS)
    done = np.array([[of(z).real, of(z).imag] for z in (1.0, 1j)]).T
    (a, b), (c, d) = np.linalg.inv(done)
    return real_linear(lambda x, y: (a * x + b * y) + 1j * (c * x + d * y))
