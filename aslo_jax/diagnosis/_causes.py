"""The hypotheses that are tried on a log of a turning flux."""

import numpy as np

from ._axes import axes
from ._circle import Circle
from ._hypotheses import Free, Hypothesis, mapped, scaled

# From a ten-thousandth to ten thousand times, five steps a decade: the fit goes on from the
# best of them.
SCALES = tuple(float(x) - 1.0 for x in 10.0 ** np.arange(-4.0, 4.01, 0.2))


def causes(circle: Circle) -> list[Hypothesis]:
    """What may be wrong with a log of a machine."""
    return [*axes(circle), *_units(), *_parameters(circle), *_timing(), *_errors()]


def _units() -> list[Hypothesis]:
    found: list[Hypothesis] = []
    signals: tuple[tuple[Free, str, str], ...] = (
        ("current", "currents", "A"),
        ("voltage", "voltages", "V"),
    )
    for signal, names, unit in signals:
        for factor, prefix in ((1e3, "m"), (1e-3, "k"), (1e6, "u")):
            found.append(
                Hypothesis(
                    f"{signal}_unit",
                    f"the {names} are in {prefix}{unit}, not in {unit}",
                    f"divide the {names} by {factor:g}",
                    plain=4,
                    **mapped(signal, scaled(factor)),
                )
            )
        found.append(
            Hypothesis(
                f"{signal}_scale",
                f"the {names} are {{0}} (per unit, counts of a converter, peak or rms?)",
                f"check the scale of the {names}",
                free=(signal,),
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
