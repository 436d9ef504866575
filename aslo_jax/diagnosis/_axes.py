"""Hypotheses on the axes that the signals of a log are written in, by the log's frame."""

import numpy as np

from ._circle import Circle
from ._hypotheses import Hypothesis, mapped, real_linear, scaled
from ._phases import PHASES, of_phases

INVARIANT = 1.5**0.5
CLARKE = real_linear(lambda a, b: a + 1j * (a + 2.0 * b) / np.sqrt(3.0))
# Line-to-line voltages ab and bc, taken for alpha and beta.
LINES = real_linear(lambda ab, bc: (2.0 * ab + bc) / 3.0 + 1j * bc / np.sqrt(3.0))
ANGLES = "check with which angle each of them was turned into d and q"


def axes(circle: Circle) -> list[Hypothesis]:
    """What may be wrong with the axes of a log of a machine."""
    found = [
        Hypothesis(
            "sign",
            "the currents have the wrong sign (positive is into the machine)",
            "turn the sign of {i} in the log",
            current=(-1.0, 0.0),
            plain=4,
        )
    ]
    if circle.frame == "abc":
        return [*found, *of_phases(), *_line_to_line()]
    if circle.frame == "dq":
        found += [*_turned_by(90, ANGLES), *_turned_by(-90, ANGLES)]
    if circle.frame == "alpha-beta":
        found += _stationary()
    if circle.phases == 3:
        found += [*_power_invariant(), *_line_to_line()]
        if circle.frame == "alpha-beta":
            found += [*_taken_for_alpha_beta(), *_turned()]
    return found


def _stationary() -> list[Hypothesis]:
    against = "of the currents is flipped against that of the voltages"
    return [
        Hypothesis(
            "beta_flipped",
            f"the beta axis {against}",
            "turn the sign of {iq}, or of {uq}, in the log",
            current=(0.0, 1.0),
            plain=4,
        ),
        Hypothesis(
            "alpha_flipped",
            f"the alpha axis {against}",
            "turn the sign of {id}, or of {ud}, in the log",
            current=(0.0, -1.0),
            plain=3,
        ),
        Hypothesis(
            "axes_swapped",
            "alpha and beta are swapped in the currents, or in the voltages",
            "{swap_i}, or {swap_u}",
            current=(0.0, 1j),
            plain=3,
        ),
        *_turned_by(90, PHASES),
        *_turned_by(-90, PHASES),
    ]


def _turned_by(degrees: int, remedy: str) -> list[Hypothesis]:
    cause = f"the currents are turned by {degrees} degrees against the voltages"
    turn = np.exp(-1j * np.radians(degrees))
    return [Hypothesis("axes_turned", cause, remedy, current=(turn, 0.0))]


def _taken_for_alpha_beta() -> list[Hypothesis]:
    where = "are taken for alpha and beta"
    return [
        Hypothesis(
            "phases_a_b",
            f"phases a and b {where}, in voltages and currents",
            "convert them: alpha = a, beta = (a + 2 b)/sqrt(3)",
            voltage=CLARKE,
            current=CLARKE,
            plain=4,
        ),
        Hypothesis(
            "phases_a_b",
            f"phases a and b of the currents {where}",
            "convert them: {id} = a, {iq} = (a + 2 b)/sqrt(3)",
            current=CLARKE,
            plain=3,
        ),
        Hypothesis(
            "phases_a_b",
            f"phases a and b of the voltages {where}",
            "convert them: {ud} = a, {uq} = (a + 2 b)/sqrt(3)",
            voltage=CLARKE,
            plain=3,
        ),
        Hypothesis(
            "line_voltages",
            f"the line-to-line voltages ab and bc {where}",
            "convert them: {ud} = (2 ab + bc)/3, {uq} = bc/sqrt(3)",
            voltage=LINES,
            plain=3,
        ),
    ]


def _power_invariant() -> list[Hypothesis]:
    found = [
        Hypothesis(
            "power_invariant",
            "the voltages are 1.22 times too small: the currents may be in the "
            "power-invariant frame, and the parameters with them",
            "multiply the voltages by sqrt(3/2) = 1.2247",
            voltage=scaled(1.0 / INVARIANT),
            plain=3,
        ),
        Hypothesis(
            "power_invariant",
            "the voltages and currents are in the power-invariant frame",
            "--power-invariant",
            voltage=scaled(INVARIANT),
            current=scaled(INVARIANT),
            plain=3,
        ),
    ]
    for signal in ("voltage", "current"):
        found.append(
            Hypothesis(
                "power_invariant",
                f"the {signal}s are in the power-invariant frame",
                f"divide the {signal}s by sqrt(3/2) = 1.2247",
                plain=3,
                **mapped(signal, scaled(INVARIANT)),
            )
        )
    return found


def _turned() -> list[Hypothesis]:
    found = []
    for degrees in (60, 120, -60, -120):
        turn = np.exp(-1j * np.radians(degrees))
        found += [
            *_turned_by(degrees, PHASES),
            Hypothesis(
                "phases_swapped",
                "two phases of the currents, or of the voltages, are swapped"
                + ("" if abs(degrees) == 120 else ", and the sign of the currents turned"),
                PHASES,
                current=(0.0, turn),
            ),
        ]
    return found


def _line_to_line() -> list[Hypothesis]:
    return [
        Hypothesis(
            "line_to_line",
            f"resistance and inductance are those {what}, not of a phase of a star",
            f"divide both by {factor:.0f}",
            resistance=1.0 / factor,
            inductance=1.0 / factor,
            of="machine",
            plain=3,
        )
        for factor, what in ((2.0, "from line to line"), (3.0, "of a branch of a delta"))
    ]
