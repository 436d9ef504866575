"""The hypotheses that are tried on a log of a turning flux."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._circle import Circle
from ._hypotheses import Hypothesis, Map, real_linear

# From a ten-thousandth to ten thousand times, five steps a decade: the fit goes on from the
# best of them.
SCALES = tuple(float(x) - 1.0 for x in 10.0 ** np.arange(-4.0, 4.01, 0.2))
INVARIANT = 1.5**0.5
CLARKE = real_linear(lambda a, b: a + 1j * (a + 2.0 * b) / np.sqrt(3.0))
# Line-to-line voltages ab and bc, taken for alpha and beta.
LINES = real_linear(lambda ab, bc: (2.0 * ab + bc) / 3.0 + 1j * bc / np.sqrt(3.0))
PHASES = "check which phase is which, and map the columns with --column"


def causes(circle: Circle) -> list[Hypothesis]:
    """What may be wrong with a log of a machine."""
    found = [*_axes(), *_units(), *_parameters(circle), *_timing(), *_errors()]
    if circle.phases == 3:
        found += _three_phases()
    return found


def _scaled(factor: float) -> Map:
    return (1.0 / factor, 0.0)


def _axes() -> list[Hypothesis]:
    turned = "the currents are turned by {} degrees against the voltages"
    against = "of the currents is flipped against that of the voltages"
    return [
        Hypothesis(
            "sign",
            "the currents have the wrong sign (positive is into the machine)",
            "turn the sign of {ia} and {ib} in the log",
            current=(-1.0, 0.0),
            plain=4,
        ),
        Hypothesis(
            "beta_flipped",
            f"the beta axis {against}",
            "turn the sign of {ib}, or of {ub}, in the log",
            current=(0.0, 1.0),
            plain=4,
        ),
        Hypothesis(
            "alpha_flipped",
            f"the alpha axis {against}",
            "turn the sign of {ia}, or of {ua}, in the log",
            current=(0.0, -1.0),
            plain=3,
        ),
        Hypothesis(
            "axes_swapped",
            "alpha and beta are swapped in the currents, or in the voltages",
            "--column {ia}={ib} --column {ib}={ia}, or the same with the voltages",
            current=(0.0, 1j),
            plain=3,
        ),
        Hypothesis("axes_turned", turned.format("90"), PHASES, current=(-1j, 0.0)),
        Hypothesis("axes_turned", turned.format("-90"), PHASES, current=(1j, 0.0)),
    ]


def _maps(signals: Sequence[str], factor: float) -> Any:
    """The same scale of some signals."""
    return dict.fromkeys(signals, _scaled(factor))


def _free(*signals: Any) -> Any:
    return signals


def _units() -> list[Hypothesis]:
    found: list[Hypothesis] = []
    for signal, names, unit in (("current", "currents", "A"), ("voltage", "voltages", "V")):
        for factor, prefix in ((1e3, "m"), (1e-3, "k"), (1e6, "u")):
            found.append(
                Hypothesis(
                    f"{signal}_unit",
                    f"the {names} are in {prefix}{unit}, not in {unit}",
                    f"divide the {names} by {factor:g}",
                    plain=4,
                    **_maps((signal,), factor),
                )
            )
        found.append(
            Hypothesis(
                f"{signal}_scale",
                f"the {names} are {{0}} (per unit, counts of a converter, peak or rms?)",
                f"check the scale of the {names}",
                free=_free(signal),
                starts=SCALES,
                plain=1,
            )
        )
    return found


def _parameters(circle: Circle) -> list[Hypothesis]:
    calibrate = "check it (a warm winding has more), or try `aslo-jax calibrate`"
    found = [
        Hypothesis(
            "inductance_unit",
            "the {inductance} is in mH, not in H",
            "multiply it by 1e-3",
            inductance=1e-3,
            of="machine",
            plain=3,
        ),
        Hypothesis(
            "resistance_unit",
            "the {resistance} is in mohm, not in ohm",
            "multiply it by 1e-3",
            resistance=1e-3,
            of="machine",
            plain=3,
        ),
        Hypothesis(
            "resistance",
            "the {resistance} is {0:.4g} ohm rather than {R:.4g}",
            calibrate,
            free=("resistance",),
            starts=(0.0, -0.5, 1.0),
            of="machine",
        ),
        Hypothesis(
            "inductance",
            "the {inductance} is {0:.4g} H rather than {L:.4g}",
            "check it, or try `aslo-jax calibrate`",
            free=("inductance",),
            starts=(0.0, -0.5, 1.0),
            of="machine",
        ),
    ]
    if circle.radius is not None:
        found.append(
            Hypothesis(
                "radius",
                "the {radius} is {0:.4g} {unit} rather than {m:.4g}, or voltages and "
                "currents are scaled alike",
                "check it, and the scale of the log",
                of="machine",
                plain=1,
            )
        )
    return found


def _timing() -> list[Hypothesis]:
    found = []
    for shift in (-2.0, -1.0, 1.0, 2.0):
        rows = f"{abs(shift):.0f} row" + ("s" if abs(shift) > 1 else "")
        found.append(
            Hypothesis(
                "voltage_timing",
                f"the voltages are {rows} {'late' if shift > 0 else 'early'} against the "
                "currents",
                f"--voltage delayed={shift:.0f}",
                shift=shift,
                plain=3,
            )
        )
    for shift, also in ((0.5, ""), (1.5, ", one row late"), (-0.5, ", one row early")):
        found.append(
            Hypothesis(
                "voltage_instant",
                f"the voltages are those of the instant of their row{also}, not the means "
                "over the interval that follows",
                "--voltage instant" if shift == 0.5 else f"--voltage delayed={shift:g}",
                shift=shift,
                plain=3,
            )
        )
    return found


def _errors() -> list[Hypothesis]:
    return [
        Hypothesis(
            "offset",
            "there is an offset: {0}",
            "--remove-offset periods, or --remove-offset standstill",
            free=("alpha", "beta"),
        ),
        Hypothesis(
            "dead_time",
            "the voltages are the commanded ones, of which {0:.3g} V a phase are lost to "
            "dead time and switches",
            "compensate it, or measure the voltages",
            free=("dead",),
        ),
    ]


def _three_phases() -> list[Hypothesis]:
    where = "are taken for alpha and beta"
    found = [
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
            "convert them: {ia} = a, {ib} = (a + 2 b)/sqrt(3)",
            current=CLARKE,
            plain=3,
        ),
        Hypothesis(
            "phases_a_b",
            f"phases a and b of the voltages {where}",
            "convert them: {ua} = a, {ub} = (a + 2 b)/sqrt(3)",
            voltage=CLARKE,
            plain=3,
        ),
        Hypothesis(
            "line_voltages",
            f"the line-to-line voltages ab and bc {where}",
            "convert them: {ua} = (2 ab + bc)/3, {ub} = bc/sqrt(3)",
            voltage=LINES,
            plain=3,
        ),
        Hypothesis(
            "power_invariant",
            "the voltages are 1.22 times too small: the currents may be in the "
            "power-invariant frame, and the parameters with them",
            "multiply the voltages by sqrt(3/2) = 1.2247",
            voltage=_scaled(1.0 / INVARIANT),
            plain=3,
        ),
    ]
    for signals in (("voltage",), ("current",), ("voltage", "current")):
        names = " and ".join(f"{name}s" for name in signals)
        found.append(
            Hypothesis(
                "power_invariant",
                f"the {names} are in the power-invariant frame",
                f"divide the {names} by sqrt(3/2) = 1.2247",
                plain=3,
                **_maps(signals, INVARIANT),
            )
        )
    for degrees in (60, 120, -60, -120):
        turn = np.exp(-1j * np.radians(degrees))
        found += [
            Hypothesis(
                "axes_turned",
                f"the currents are turned by {degrees} degrees against the voltages",
                PHASES,
                current=(turn, 0.0),
            ),
            Hypothesis(
                "phases_swapped",
                "two phases of the currents, or of the voltages, are swapped"
                + ("" if abs(degrees) == 120 else ", and the sign of the currents turned"),
                PHASES,
                current=(0.0, turn),
            ),
        ]
    for factor, what in ((2.0, "from line to line"), (3.0, "of a branch of a delta")):
        found.append(
            Hypothesis(
                "line_to_line",
                f"resistance and inductance are those {what}, not of a phase of a star",
                f"divide both by {factor:.0f}",
                resistance=1.0 / factor,
                inductance=1.0 / factor,
                of="machine",
                plain=3,
            )
        )
    return found
