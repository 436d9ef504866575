"""Claims of the paper's 3.1.2: Prop. 2, its determinant, and observability."""

import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from . import pmsm, settings as s
from .pmsm import Reversal
from .settling import Trace, size

WB = "Wb"


def proposition(run: Simulation) -> list[Claim]:
    """P1 of Prop. 2, from the closed loop."""
    raw = size(run, "ASLO")
    place, identity = "3.1.2, Prop. 2, P1", "The ASLO is the flux, for all t >= 0."
    exact = {
        c: size(run, f"ASLO exact, {c}")[run.t > 9e-3].max()
        for c in ("Repeat", "least squares")
    }
    transient = [
        Claim(
            f"ASLO, error at {t:g} s",
            f"ours, on {place}",
            "The transient of the printed start is over after some 5/lambda.",
            f"error at {t:g} s, filters from zero, lambda = 5 rad/s",
            _at(run, raw, t),
            WB,
            Below(bound),
        )
        for t, bound in ((1.0, 2e-2), (2.0, 5e-4), (5.0, 1e-8))
    ]
    return [
        Claim(
            "ASLO, printed start",
            place,
            identity,
            "largest error for t >= 1 ms, filters from zero",
            float(raw[1:].max()),
            WB,
            Below(1e-6),
            Above(s.MAGNET),
            "with the filters from zero it holds up to a transient, which is unbounded "
            "where Delta crosses zero",
            "At the instants saved, 1 ms apart; the peak depends on them.",
        ),
        *transient,
        Claim(
            "ASLO, exact start",
            place,
            identity,
            "largest error for t >= 10 ms, Repeat and least squares, exact start",
            float(max(exact.values())),
            WB,
            Below(1e-8),
            remark=f"Repeat {exact['Repeat']:.0e} Wb, least squares "
            f"{exact['least squares']:.0e} Wb: the tolerance of the solver.",
        ),
        Claim(
            "ASLO, magnet flux",
            "3.1.3, FO2",
            "In contrast with the ASLO, FO2 assumes that the magnet flux is known "
            "(Prop. 2 prints it in z3).",
            "largest error for t >= 10 ms with lambda_m = 0 in z3, exact start",
            float(size(run, "ASLO without m")[run.t > 9e-3].max()),
            WB,
            Below(1e-8),
            remark="A constant in z3 drops out with the exact start, and leaves a "
            "transient with the printed one.",
        ),
    ]


def asymptotic(run: Simulation) -> list[Claim]:
    """P2 of Prop. 2, from the closed loop."""
    place = "3.1.2, Prop. 2, P2"
    law = "The error of the A-ASLO obeys e' = -gamma e"
    return [
        Claim(
            "A-ASLO, gamma < lambda",
            place,
            f"{law}, here with gamma = 2 and lambda = 5.",
            "decay rate of the error, t in [3, 5] s",
            decay_rate(run, "A-ASLO slow", 3.0, 5.0),
            "rad/s",
            Near(s.SLOW, 0.1),
        ),
        Claim(
            "A-ASLO, gamma > lambda",
            place,
            f"{law}, here with gamma = 20 and lambda = 5.",
            "decay rate of the error, t in [2, 4] s",
            decay_rate(run, "A-ASLO fast", 2.0, 4.0),
            "rad/s",
            Near(s.FAST, 0.5),
            Near(s.RATE, 0.75),
            "the rate is min(gamma, lambda)",
            "The A-ASLO follows the ASLO, whose own transient decays as a polynomial times "
            "exp(-lambda t).",
        ),
        Claim(
            "A-ASLO, exact start",
            place,
            f"{law}, here with gamma = 20 and lambda = 5.",
            "decay rate of the error, t in [0.1, 0.6] s, exact start",
            decay_rate(run, "A-ASLO fast, exact", 0.1, 0.6),
            "rad/s",
            Near(s.FAST, 1e-2),
            remark="With the exact start P2 holds as printed.",
        ),
    ]


def determinant(run: Simulation, steady: Simulation, reversal: Reversal) -> list[Claim]:
    """`Delta != 0`, and "no observability or excitation"."""
    place, never = "3.1.2, Prop. 2", "Delta is assumed to differ from zero for all t >= 0."
    delta = run.estimates["Delta"].value[:, 0]
    early = run.t <= 0.5
    crossings = run.t[1:][early[1:] & (delta[1:] * delta[:-1] < 0)]
    speeds = np.array(pmsm.STEADY_SPEEDS)
    last = steady.estimates["Delta"].value[:, -1, 0]
    electrical = 5 * speeds
    theory = -((s.MAGNET / float(s.motor().inductance)) ** 2) * s.RATE * electrical**3
    theory /= (s.RATE**2 + electrical**2) ** 2
    turning = speeds != 0
    before, after = np.interp([1.5, 4.5], reversal.t, reversal.delta)
    names = ("Repeat", "least squares")
    rest, moving = (pmsm.STEADY_SPEEDS.index(speed) for speed in (0.0, 2.0))
    certificate, at_speed = (
        [float(steady.estimates[n].certificate[i, -1]) for n in names]
        for i in (rest, moving)
    )
    lost = size(steady, "least squares")[rest]
    free = "No observability or excitation condition is imposed."
    return [
        Claim(
            "Delta at t = 0",
            place,
            never,
            "its size at t = 0, filters from zero",
            float(abs(delta[0])),
            "A^2",
            Above(1e-9),
            Near(0.0, 1e-12),
            "it is zero at t = 0, whatever the signals, since w7 and w8 start at zero",
        ),
        Claim(
            "Delta in the start-up",
            place,
            never,
            "changes of its sign for t in (0, 0.5] s, filters from zero",
            float(crossings.size),
            "",
            Near(0, 0),
            Above(0.5),
            "it crosses zero while the filters settle, and the estimate has a pole there",
            f"At {', '.join(f'{t:.3g}' for t in crossings)} s.",
        ),
        Claim(
            "Delta in steady state",
            "ours, on 3.1.2, eq. (del)",
            "Delta = -(m/L)^2 lambda we^3/(lambda^2 + we^2)^2 at the electrical speed we.",
            "largest relative departure, speeds from -2 to 4 rad/s",
            float(np.abs(last[turning] / theory[turning] - 1).max()),
            "",
            Below(1e-6),
            remark="With the third power of the speed it vanishes at standstill.",
        ),
        Claim(
            "Delta at a reversal",
            place,
            never,
            "its sign after a reversal of the speed times that before it",
            float(np.sign(before) * np.sign(after)),
            "",
            Near(1, 0),
            Near(-1, 0),
            "it changes its sign at every reversal of the speed",
        ),
        Claim(
            "observability at standstill",
            "abstract, 1",
            free,
            "certificate at standstill after 8 s, larger one of Repeat and least squares",
            max(certificate),
            "",
            Above(1e-6),
            Below(1e-12),
            "at standstill the flux is not observable: both certificates vanish",
            f"At 2 rad/s they are {at_speed[0]:.2g} and {at_speed[1]:.2g}.",
        ),
        Claim(
            "error at standstill",
            "abstract, 1",
            free,
            "last error over the first one, 8 s at standstill, least squares",
            float(lost[-1] / lost[0]),
            "",
            Below(1e-2),
            Near(1.0, 1e-6),
            "what is wrong at the start stays wrong; the observer coasts and says so",
        ),
        Claim(
            "Repeat at a reversal",
            place,
            "Where Delta vanishes, a standard modification such as freezing avoids the "
            "singularity.",
            "largest error after 1 s over that of least squares, speed 2 sin t, 10 mA and "
            "0.1 V of noise, not frozen",
            _later(reversal, "Repeat, no guard") / _later(reversal, "least squares"),
            "",
            Above(10.0),
            remark="Largest errors: "
            + ", ".join(f"{n}: {_later(reversal, n):.2g} Wb" for n in reversal.error)
            + "; all but the first one coast below their certificate.",
        ),
    ]


def decay_rate(run: Simulation, name: str, t1: float, t2: float) -> float:
    """The mean slope (rad/s) of the logarithm of an error between t1 and t2 (s)."""
    within = (run.t > t1 - 1e-9) & (run.t < t2 + 1e-9)
    return -float(np.polyfit(run.t[within], np.log(size(run, name)[within]), 1)[0])


def _at(run: Simulation, error: np.ndarray, t: float) -> float:
    return float(error[np.searchsorted(run.t, t - 1e-9)])


def _later(reversal: Reversal, name: str) -> float:
    return Trace("", name, "", WB, reversal.t, reversal.error[name], 1.0, 1.0).peak(1.0)
