"""Claims of the paper's sections 2.2 to 2.4, but for O2: Prop. 1, Cor. 1, O1, O3, O4."""

import math

import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from . import experiments as s

UNIT = "m/s"


def identity(scenarios: dict[str, Simulation]) -> list[Claim]:
    """Prop. 1 and O1, from [`aslo_jax.paper._section2.experiments.scenarios`][]."""
    free, displaced = scenarios["free"], scenarios["displaced"]
    prop = "x2 = pF[y] + F[u]/lambda for all t >= 0."
    # The transient relative to x2(0) exp(-lambda t), where it is not yet small.
    early = free.t < 2.0
    sign = s.error(free, "ASLO")[early, 0] / (s.SPEED * np.exp(-s.RATE * free.t[early]))
    transient = (s.RATE * displaced.x[0, 0] - s.SPEED) * np.exp(-s.RATE * displaced.t)
    return [
        Claim(
            "identity, printed start",
            "2.2, Prop. 1",
            prop,
            "largest error for t >= 0, filters from zero",
            _peak(s.error(free, "ASLO")),
            UNIT,
            Below(1e-9),
            Near(s.SPEED, 1e-9),
            "with the filters from zero it holds up to a transient that begins at x2(0)",
            "The derivation takes F[1] as 1 and F[x2'] with F[x2](0) as zero.",
        ),
        Claim(
            "identity, exact start",
            "2.2, Prop. 1",
            prop,
            "largest error for t >= 1 ms, y(0) = 0.7 m, exact start",
            _peak(s.error(displaced, "ASLO exact")[1:]),
            UNIT,
            Below(1e-8),
            remark="Divided by F[1] = 1 - exp(-lambda t), and with the filter of pF[y] "
            "started at y(0), the identity holds from the first instant on.",
        ),
        Claim(
            "transient for u = 0",
            "2.4, O1",
            "For u = 0 the right-hand side is (1 + exp(-lambda t)) x2(0).",
            "coefficient of exp(-lambda t) x2(0), mean over 2 s",
            float(sign.mean() if np.ptp(sign) < 1e-6 else np.nan),
            "",
            Near(1.0, 1e-6),
            Near(-1.0, 1e-6),
            "(1 - exp(-lambda t)) x2(0)",
            "The printed sign would start the estimate at 2 x2(0), not at 0.",
        ),
        Claim(
            "transient for y(0) != 0",
            "ours, on 2.4, O1",
            "With the printed start the error is (lambda y(0) - x2(0)) exp(-lambda t).",
            "largest departure from this formula, y(0) = 0.7 m",
            _peak(s.error(displaced, "ASLO")[:, 0] - transient),
            UNIT,
            Below(1e-9),
        ),
    ]


def corollary(
    transients: Simulation, gains: Simulation, scenarios: dict[str, Simulation]
) -> list[Claim]:
    """Cor. 1, from the runs of figures 1b and 1c and from O1's."""
    slow = s.member(gains, s.GAINS.index(2.0))
    fast = s.member(gains, s.GAINS.index(10.0))
    free = scenarios["free"]
    law = "The error of the A-ASLO obeys e' = -gamma e"
    departure = s.error(free, "A-ASLO")[:, 0] + s.SPEED * np.exp(-s.GAIN * free.t)
    return [
        Claim(
            "rate, gamma < lambda",
            "2.3, Cor. 1",
            f"{law}, here with gamma = 2 and lambda = 10.",
            "decay rate of the error, t in [2, 4] s",
            decay_rate(s.member(transients, s.RATES.index(10.0)), "A-ASLO"),
            "rad/s",
            Near(2.0, 1e-3),
        ),
        Claim(
            "rate, gamma > lambda",
            "2.3, Cor. 1",
            f"{law}, here with gamma = 10 and lambda = 2.5.",
            "decay rate of the error, t in [2, 4] s",
            decay_rate(fast, "A-ASLO"),
            "rad/s",
            Near(10.0, 0.1),
            Near(s.RATE_1C, 1e-2),
            "the rate is min(gamma, lambda)",
            "The A-ASLO follows the ASLO, whose own transient decays with lambda.",
        ),
        Claim(
            "error, printed start",
            "2.3, Cor. 1",
            f"{law}, here with gamma = 2 and lambda = 3.",
            "largest departure from e(0) exp(-gamma t)",
            _peak(departure),
            UNIT,
            Below(1e-9),
            Near(s.SPEED * 8 / 27, 1e-5),
            "e' = -gamma e + gamma e_ASLO",
            "Its peak is x2(0) 8/27, at t = ln(3/2) s.",
        ),
        Claim(
            "error, exact start",
            "2.3, Cor. 1",
            f"{law}, here with gamma = 2 and 10, lambda = 2.5.",
            "largest departure from e(0) exp(-gamma t), exact start",
            max(
                _peak(s.error(run, "A-ASLO exact")[:, 0] + s.SPEED * np.exp(-gamma * run.t))
                for run, gamma in ((slow, 2.0), (fast, 10.0))
            ),
            UNIT,
            Below(1e-8),
            remark="With the exact start the corollary holds as printed.",
        ),
    ]


def chains(fourth: Simulation, fifth: Simulation) -> list[Claim]:
    """O3, from [`chain`][aslo_jax.paper._section2.experiments.chain] without bias."""
    printed = np.sqrt(np.mean(s.error(fourth, "printed")[5:] ** 2, axis=0))
    w = 1.3
    lines = []
    for name, column, formula, theory, correction in (
        ("x2", 0, "x2 = w1y + x3 - x4 + w1u.", None, ""),
        (
            "x3",
            1,
            "x3 = w2y + 2 x4 - w2u.",
            2 / math.hypot(1, w) / math.sqrt(2),
            "x3 = w2y + 2 x4 - 2 w1u - w2u",
        ),
        (
            "x4",
            2,
            "x4 = w3y + w3u + w2u + w2u.",
            w / (1 + w**2) / math.sqrt(2),
            "x4 = w3y + w3u + w2u + w1u",
        ),
    ):
        lines.append(
            Claim(
                f"chain of four, {name}",
                f"2.4, O3, eq. ({name})",
                formula,
                "rms error, settled, u = sin 1.3 t, lambda = 1",
                float(printed[column]),
                f"m/s^{column + 1}" if column else UNIT,
                Below(1e-8),
                None if theory is None else Near(theory, 1e-3),
                correction,
                "" if theory is None else "The right-hand side's x3, x4 are the true ones.",
            )
        )
    return [
        *lines,
        Claim(
            "chain of four, corrected",
            "ours, on 2.4, O3",
            "The corrected formulas are the ASLO of the fourth-order chain.",
            "largest error, from rest",
            _peak(s.error(fourth, "corrected")),
            "SI",
            Below(1e-8),
        ),
        Claim(
            "chains of four and five",
            "2.4, O3",
            "It can be easily extended for the n-th order system.",
            "largest error of the library's observers, from rest",
            max(_peak(s.error(run, "ASLO")) for run in (fourth, fifth)),
            "SI",
            Below(1e-8),
        ),
    ]


def biases(scenarios: dict[str, Simulation], fourth: Simulation) -> list[Claim]:
    """O4, from the runs with a bias or a sinusoid, and a biased fourth-order chain."""
    on_input, on_output = scenarios["input bias"], scenarios["output bias"]
    delta, lam, gamma = s.BIAS, s.RATE, s.GAIN
    insensitive = "The ASLO is insensitive to a constant disturbance of the output."
    vanishing = "The effect of a constant disturbance of the input vanishes exponentially."

    def last(run, name):
        return float(np.abs(s.error(run, name)[-1]).max())

    def rms(name):
        run = scenarios["ripple"]
        return float(np.sqrt(np.mean(s.error(run, name)[run.t > 15.0] ** 2)))

    bias = "error after 20 s, u seen with 0.2 m/s^2 added"
    return [
        Claim(
            "output offset",
            "2.4, O4",
            insensitive,
            "error after 20 s, 0.2 m added to y",
            last(on_output, "ASLO"),
            UNIT,
            Below(1e-9),
            remark="So is the Luenberger observer: "
            f"{last(on_output, 'Luenberger'):.0e} m/s.",
        ),
        Claim(
            "output offset, chain of four",
            "2.4, O4",
            "This robustness holds true for the n-th order system.",
            "largest error after 24 s, 0.2 m added to y",
            last(fourth, "ASLO"),
            "SI",
            Below(1e-7),
        ),
        Claim(
            "output offset, exact start",
            "2.4, O4",
            insensitive,
            "largest error for t >= 1 ms, 0.2 m added to y, exact start",
            _peak(s.error(on_output, "ASLO exact")[1:]),
            UNIT,
            Below(1e-8),
        ),
        Claim(
            "input bias, ASLO",
            "2.4, O4",
            vanishing,
            bias,
            last(on_input, "ASLO"),
            UNIT,
            Below(1e-6),
            Near(delta / lam, 1e-9),
            "an error delta/lambda stays, since F[delta] tends to delta",
        ),
        Claim(
            "input bias, A-ASLO",
            "2.4, O4",
            vanishing,
            bias,
            last(on_input, "A-ASLO"),
            UNIT,
            Below(1e-6),
            Near(delta * (1 / lam + 1 / gamma), 1e-9),
            "an error delta (1/lambda + 1/gamma) stays",
        ),
        Claim(
            "input bias, Luenberger",
            "2.4, O4",
            "Such a disturbance induces an unstable behaviour in the Luenberger observer.",
            bias,
            last(on_input, "Luenberger"),
            UNIT,
            Above(10.0),
            Near(delta / lam, 1e-9),
            "it is stable; an error delta/gamma_L stays, the same as the ASLO's",
        ),
        Claim(
            "input bias, other filter",
            "2.4, O4",
            vanishing,
            bias + ", F = (2 lambda p + lambda^2)/(p + lambda)^2",
            last(on_input, "bias-rejecting"),
            UNIT,
            Below(1e-6),
            remark="A filter with F'(0) = 0 makes the claim true.",
        ),
        Claim(
            "sinusoid on the sensor",
            "conclusions",
            "Disturbances with a known internal model might be rejected by another filter.",
            "rms error, settled, 0.1 m at 5 rad/s on y, F with zeros at +-5j rad/s",
            rms("sinusoid-rejecting"),
            UNIT,
            Below(1e-6),
            remark=f"The first-order filter leaves {rms('ASLO'):.2g} m/s rms.",
        ),
    ]


def decay_rate(run: Simulation, name: str, t1: float = 2.0, t2: float = 4.0) -> float:
    """Mean decay rate (rad/s) of the first error of an observer between t1 and t2 (s)."""
    error = np.abs(s.error(run, name)[:, 0])
    first, last = np.searchsorted(run.t, [t1 - 1e-6, t2 - 1e-6])
    return float(np.log(error[first] / error[last]) / (run.t[last] - run.t[first]))


def _peak(error) -> float:
    return float(np.abs(error).max())
