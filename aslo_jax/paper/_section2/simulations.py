"""Claims of the paper's section 2.5, on its simulations."""

import itertools
import math

import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from .._linear import realisation
from .._settled import settled
from . import experiments as s
from .theory import decay_rate

UNIT = "m/s"
SETTLED = 0.05  # of x2(0): what counts as settled, and as near zero


def figure1(transients: Simulation, gains: Simulation) -> list[Claim]:
    """Figures 1a to 1d."""
    by_rate = [s.member(transients, i) for i in range(len(s.RATES))]
    by_gain = [s.member(gains, i) for i in range(len(s.GAINS))]
    settle = {n: [settling(r, n) for r in by_rate] for n in ("ASLO", "A-ASLO")}
    settle["gamma"] = [settling(r, "A-ASLO") for r in by_gain]
    ratio = "largest ratio of successive 5 % settling times, lambda = " + _listed(s.RATES)
    five, ten = (by_rate[s.RATES.index(rate)] for rate in (5.0, 10.0))
    return [
        Claim(
            "ASLO, speed with lambda",
            "2.5, fig. 1a",
            "As lambda increases, the error of the ASLO converges faster.",
            ratio,
            _growth(settle["ASLO"]),
            "",
            Below(1.0),
            remark=f"Settling times: {_listed(settle['ASLO'])} s, ln(20)/lambda.",
        ),
        Claim(
            "ASLO, overshoot",
            "2.5, fig. 1a",
            "It does so without any overshoot.",
            "largest error beyond zero",
            float(max(max(s.error(r, "ASLO")[1:, 0].max(), 0.0) for r in by_rate)),
            UNIT,
            Below(1e-9),
        ),
        Claim(
            "A-ASLO, convergence",
            "2.5, fig. 1b",
            "The A-ASLO with gamma = 2 converges asymptotically.",
            "largest error after 8 s over x2(0)",
            float(max(abs(s.error(r, "A-ASLO")[-1, 0]) for r in by_rate) / s.SPEED),
            "",
            Below(1e-2),
        ),
        Claim(
            "A-ASLO, settling with lambda",
            "2.5, fig. 1b",
            "Its convergence improves as lambda increases, gamma = 2.",
            ratio,
            _growth(settle["A-ASLO"]),
            "",
            Below(1.0),
            remark=f"Settling times: {_listed(settle['A-ASLO'])} s; with the exact start "
            f"{_listed([settling(r, 'A-ASLO exact') for r in by_rate])} s.",
        ),
        Claim(
            "A-ASLO, rate with lambda",
            "2.5, fig. 1b",
            "Its convergence rate improves as lambda increases, gamma = 2.",
            "decay rate with lambda = 10 over that with lambda = 5",
            decay_rate(ten, "A-ASLO") / decay_rate(five, "A-ASLO"),
            "",
            Above(1.01),
            Near(1.0, 1e-3),
            "the rate is min(gamma, lambda) and stays at gamma from lambda = gamma on; "
            "only the settling time still shrinks",
        ),
        Claim(
            "A-ASLO, speed with gamma",
            "2.5, fig. 1c",
            "The convergence time of the A-ASLO decreases with gamma, lambda = 2.5.",
            "largest ratio of successive 5 % settling times, gamma = " + _listed(s.GAINS),
            _growth(settle["gamma"]),
            "",
            Below(1.0),
            remark=f"Settling times: {_listed(settle['gamma'])} s, never below the ASLO's "
            f"{settle['ASLO'][s.RATES.index(s.RATE_1C)]:.3g} s.",
        ),
        Claim(
            "ASLO and Luenberger",
            "2.5, fig. 1d",
            "Their errors are almost identical for gamma_L = lambda, which is surprising "
            "and very hard to explain.",
            "largest difference, lambda = " + _listed(s.RATES),
            _difference(transients),
            UNIT,
            Below(1e-10),
            remark="Identical, for they have the same transfer function and start.",
        ),
    ]


def figure2(noise: Simulation, printed: s.Printed) -> list[Claim]:
    """Figure 2: white noise on u."""
    settled = noise.t[0] > 5.0
    rms, theory = {}, {}
    for name, observer in s.three(printed).items():
        error = s.error(noise, name)[:, settled]
        rms[name] = float(np.sqrt(np.mean(error**2)))
        theory[name] = math.sqrt(realisation(observer).variance(s.INTENSITY, 0.0))
    setting = (
        f"rms error after 5 s, {s.REALISATIONS} realisations of {s.NOISE_SPAN:g} s, "
        f"intensity {s.INTENSITY:g} m^2/s^3"
    )
    near = "Both errors remain near zero under white noise on u."
    scale = "The paper does not print its noise; here near zero is a third of x2(0)."
    return [
        *(
            Claim(
                f"noise on u, {name}",
                "2.5, fig. 2",
                near,
                setting,
                rms[name],
                UNIT,
                Below(s.SPEED / 3),
                remark=f"{scale} Lyapunov's equation gives {theory[name]:.4f} m/s.",
            )
            for name in ("ASLO", "A-ASLO")
        ),
        Claim(
            "noise on u, ASLO better",
            "2.5, fig. 2",
            "A slightly better response is seen from the ASLO.",
            "rms error of the A-ASLO over that of the ASLO",
            rms["A-ASLO"] / rms["ASLO"],
            "",
            Above(1.0),
            remark="More than slightly: sqrt(3.1) = 1.76 in theory, for any white noise.",
        ),
        Claim(
            "noise on u, Luenberger",
            "2.5, fig. 2",
            "The Luenberger observer performs very similarly to the ASLO.",
            "largest difference",
            _difference(noise),
            UNIT,
            Below(1e-9),
        ),
    ]


def figure3(parasitics: Simulation) -> list[Claim]:
    """Figure 3: parasitic dynamics between the u that the observers see and the plant."""
    t = parasitics.t[0]
    asymptotic, algebraic = (s.error(parasitics, n)[..., 0] for n in ("A-ASLO", "ASLO"))
    early = t <= 10.0
    rms = [np.sqrt(np.mean(e[:, early] ** 2, axis=1)) for e in (asymptotic, algebraic)]
    settled = early & (t > 5.0)
    slow = len(s.LAGS) - 1
    drift = s.LAGS[slow] * s.FREQUENCY * (1 / s.RATE + 1 / s.GAIN)
    return [
        Claim(
            "small tau",
            "2.5, fig. 3",
            "Both observers achieve satisfactory performance for small tau.",
            f"largest error of either, t in [5, 10] s, tau = {s.LAGS[0]:g} s",
            float(max(np.abs(e[0, settled]).max() for e in (asymptotic, algebraic))),
            UNIT,
            Below(SETTLED * s.SPEED),
        ),
        Claim(
            "tau, ASLO better",
            "2.5, fig. 3",
            "The ASLO systematically ensures a better behaviour.",
            "least ratio of rms errors over 10 s, A-ASLO to ASLO, tau = " + _listed(s.LAGS),
            float((rms[0] / rms[1]).min()),
            "",
            Above(1.0),
            remark=f"For each tau: {_listed(rms[0] / rms[1])}.",
        ),
        Claim(
            "tau, drift of the A-ASLO",
            "2.5, fig. 3",
            "For slower parasitic dynamics the error of the A-ASLO drifts away from zero.",
            "its size after a quarter period of u, tau = 1 s",
            float(abs(asymptotic[slow, -1])),
            UNIT,
            Near(drift, 0.01 * drift),
            remark="The lag acts as an input error tau u', which the A-ASLO passes on "
            "with the factor 1/lambda + 1/gamma: the error follows u' and is bounded.",
        ),
        Claim(
            "tau, no drift of the ASLO",
            "2.5, fig. 3",
            "The drift is one of the A-ASLO alone (implied).",
            "error of the ASLO over that of the A-ASLO after a quarter period of u",
            float(algebraic[slow, -1] / asymptotic[slow, -1]),
            "",
            Below(0.01),
            Near(0.4, 1e-3),
            "the ASLO drifts too, gamma/(gamma + lambda) = 0.4 times as far",
        ),
        Claim(
            "tau, Luenberger",
            "2.5, fig. 3",
            "The behaviour of the Luenberger observer is very similar to the ASLO's.",
            "largest difference, tau = " + _listed(s.LAGS),
            _difference(parasitics),
            UNIT,
            Below(1e-9),
        ),
    ]


def settling(run: Simulation, name: str) -> float:
    """When the error of an observer is within 5 % of x2(0) for good (s)."""
    return settled(np.asarray(run.t), s.error(run, name)[:, 0], SETTLED * s.SPEED)


def _growth(times: list[float]) -> float:
    """The largest ratio of successive times; below 1 if each is shorter than the last."""
    return max(later / sooner for sooner, later in itertools.pairwise(times))


def _difference(batch: Simulation) -> float:
    return float(np.abs(s.error(batch, "ASLO") - s.error(batch, "Luenberger")).max())


def _listed(values) -> str:
    return ", ".join(f"{v:.3g}" for v in values)
