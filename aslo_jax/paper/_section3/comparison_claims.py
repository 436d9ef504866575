"""Claims of the paper's 3.1.3: the observers beside each other, and the drive."""

import jax
import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from . import pmsm, settings as s
from .settling import closed_loop

WB = "Wb"


def comparison(run: Simulation, growth: np.ndarray) -> list[Claim]:
    """3.1.3: the five observers beside each other."""
    found = {trace.observer: trace for trace in closed_loop(run)}
    settled = {name: found[name].settled(0.05) for name in pmsm.PAPER}
    peak = {name: found[name].peak(1e-3) for name in pmsm.PAPER}
    others = [name for name in pmsm.PAPER if name != "ASLO"]
    peers = [name for name in others if "ASLO" not in name]
    large = [name for name in pmsm.PAPER if name != "FO2, gamma 5"]
    small, tuned = found["FO2, gamma 5"], found["FO2, gamma 1000"]
    place = "3.1.3"
    fastest = "The ASLO has the fastest rate of convergence"
    times = ", ".join(f"{n} {_listed(t)}" for n, t in settled.items())
    exact = max(found[n].settled(0.05) for n in pmsm.EXACT if n.startswith("ASLO"))
    return [
        Claim(
            "all errors converge",
            place,
            "All observer errors converge to zero.",
            "largest final error, FO2 with gamma = 1000",
            max(found[name].final for name in large),
            WB,
            Below(1e-6),
        ),
        Claim(
            "FO2 with gamma = 5",
            place,
            "All observer errors converge to zero, with lambda = gamma = 5 for all.",
            "final error of FO2 after 10 s over the magnet flux, gamma = 5",
            small.final / s.MAGNET,
            "",
            Below(0.05),
            Above(0.05),
            "with gamma = 5 the error of FO2 shrinks too slowly to be seen to converge",
        ),
        Claim(
            "FO2 with gamma = 1000",
            place,
            "To improve FO2 it was necessary to take gamma of the order of 1000.",
            "final error with gamma = 5 over that with gamma = 1000",
            small.final / tuned.final,
            "",
            Above(100.0),
        ),
        Claim(
            "ASLO, fastest",
            place,
            f"{fastest}.",
            "its 5 % settling time over the shortest one of FO1, FO2 and FO3",
            settled["ASLO"] / min(settled[name] for name in peers),
            "",
            Below(1.0),
            Above(1.0),
            "FO1, and FO2 with gamma = 1000, settle before it; its printed start has to "
            "wait for its filters",
            f"Settling times: {times}.",
        ),
        Claim(
            "ASLO with the exact start, fastest",
            f"ours, on {place}",
            f"{fastest}, with the exact start.",
            "its 5 % settling time over the shortest one of FO1, FO2 and FO3",
            exact / min(settled[name] for name in peers),
            "",
            Below(1.0),
            remark="It is below 5 % at every instant after t = 0.",
        ),
        Claim(
            "ASLO, overshoot",
            place,
            f"{fastest} and the smaller overshoot.",
            "its largest error for t >= 1 ms over the largest one of the other observers",
            peak["ASLO"] / max(peak[name] for name in others),
            "",
            Below(1.0),
            Above(1.0),
            "its printed start has the largest overshoot of all, a pole of 1/Delta; the "
            "exact start has none",
        ),
        Claim(
            "FO3, close to the ASLO",
            place,
            "The ASLO is followed closely by FO3.",
            "5 % settling time of FO3 over that of the ASLO",
            settled["FO3"] / settled["ASLO"],
            "",
            Near(1.0, 0.25),
            remark="Both wait for the same transient of the filters.",
        ),
        *mixing(run),
        Claim(
            "FO1, any gain",
            "ours, on 3.1.3, FO1",
            "Sampled at 5 kHz, FO1 is stable at any gain.",
            "largest ratio of the error after 1 s to the first one, gamma from 1e-2 to 1e8",
            float(np.nan_to_num(growth, nan=np.inf).max()),
            "",
            Below(1.0),
        ),
    ]


def mixing(run: Simulation) -> list[Claim]:
    """The error dynamics that 3.1.3 gives for FO3."""
    departure = {}
    for name, delta in (("FO3", "Delta"), ("FO3 exact", "Delta exact")):
        integral = run.estimates[delta].value[:, 1:]
        error = run.estimates[name].value - run.hidden
        law = np.exp(-s.GAIN * integral) * error[:1]
        departure[name] = float(np.linalg.norm(error - law, axis=1).max())
    law = "The error of FO3 obeys e' = -gamma Delta^2 e."
    quantity = "largest departure from e(0) exp(-gamma int Delta^2)"
    return [
        Claim(
            "FO3, printed start",
            "3.1.3, FO3",
            law,
            f"{quantity}, filters from zero",
            departure["FO3"],
            WB,
            Below(1e-8),
            Above(1e-2),
            "with the filters from zero their transient drives it",
        ),
        Claim(
            "FO3, exact start",
            "3.1.3, FO3",
            law,
            f"{quantity}, exact start",
            departure["FO3 exact"],
            WB,
            Below(1e-8),
        ),
    ]


def drive(run: Simulation) -> list[Claim]:
    """The load, the current and the speed of 3.1.3."""
    later = run.t > 1.0
    scenario = "Motor BMP0701F, maximum current 2.3 A, load 3 + 0.5 sin 0.1t N m."
    tracking = np.abs(run.x.speed - jax.jit(jax.vmap(s.reference))(run.t))[later].max()
    return [
        Claim(
            "load current, printed torque",
            "3.1.3, Table 1, eq. (sys)",
            scenario,
            "current for 3.5 N m with the torque n_p (y2 phi1 - y1 phi2)",
            pmsm.current_needed(s.LARGEST_LOAD, 1.0),
            "A",
            Below(s.CURRENT_LIMIT),
            Near(s.LARGEST_LOAD / (5 * s.MAGNET), 1e-3),
            "the printed torque takes more current than the motor has; with the factor "
            "3/2 of the amplitude-invariant convention it takes 2.24 A",
        ),
        Claim(
            "load current, factor 3/2",
            "ours, on 3.1.3, Table 1",
            scenario,
            "current for 3.5 N m with 3/2 n_p (y2 phi1 - y1 phi2)",
            pmsm.current_needed(s.LARGEST_LOAD, 1.5),
            "A",
            Below(s.CURRENT_LIMIT),
            remark="Largest in the closed loop, t in [1, 10] s: "
            f"{np.linalg.norm(run.y, axis=1)[later].max():.3g} A.",
        ),
        Claim(
            "speed",
            "3.1.3",
            "The motor is driven with the desired speed 2 + 0.5 sin t rad/s.",
            "largest error of the speed, t in [1, 10] s, PI control, measured angle",
            float(tracking),
            "rad/s",
            Below(0.05),
        ),
    ]


def _listed(t: float) -> str:
    return f"{t:.2g} s" if np.isfinite(t) else "not within 10 s"
