"""Claims of the paper's Props 4 and 5: the identities, and the A-ASLO's error."""

import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from . import loops, settings as s

MIXED = "m/s, rad/s"


def proposition4(run: Simulation) -> list[Claim]:
    """P1 of Prop. 4, from [`leg`][aslo_jax.paper._section4.loops.leg]."""
    late, later = run.t > s.SETTLED, run.t > 0
    printed, half = (loops.error(run, name) for name in ("Prop. 4", "Prop. 4, F[1/z1]"))
    corrected = loops.error(run, "Prop. 4, corrected")
    place, window = "4.1, Prop. 4, P1", f"t in [{s.SETTLED:g}, {s.SPAN:g}] s"
    states = run.states["Prop. 4"]
    ratio = states["F[1/z1]"][later] / states["F[z1]"][later]
    factor = run.estimates["Prop. 4"].value[later, 1] - ratio * run.hidden[later, 1]
    twice = printed[:, 2] - 2 * states["w2"] / (s.BODY * s.RATE)
    return [
        Claim(
            "leg, q2' as printed",
            place,
            "q2' = w1/(z1 F[z1]).",
            f"largest error of q2', {window}",
            _peak(printed[late, 1]),
            "rad/s",
            Below(1e-8),
            Above(0.1),
            "the denominator is z1 F[1/z1], as in the proof of appendix D",
        ),
        Claim(
            "leg, what q2' as printed is",
            f"ours, on {place}",
            "What is printed is q2' F[1/z1]/F[z1].",
            "largest departure from this, t >= 1 ms",
            _peak(factor),
            "rad/s",
            Below(1e-8),
        ),
        Claim(
            "leg, q2' with F[1/z1]",
            f"ours, on {place}, and appendix D",
            "q2' = w1/(z1 F[1/z1]).",
            "largest error of q2', t >= 1 ms, pF[q2] from q2(0)",
            _peak(half[later, 1]),
            "rad/s",
            Below(1e-8),
            remark="It needs no F[1]: there is no transient, but for that of pF[q2].",
        ),
        Claim(
            "leg, q1' as printed",
            place,
            "q1' = pF[q1] + w4.",
            f"largest error of q1', {window}",
            _peak(printed[late, 0]),
            "m/s",
            Below(1e-8),
            Above(1e-2),
            "w4 is driven by q2' as printed, and has its error; with F[1/z1] it holds",
            f"With F[1/z1] the error is {_peak(half[late, 0]):.0e} m/s.",
        ),
        Claim(
            "leg, q3' as printed",
            f"{place}, and appendix D",
            "q3' = w2 + w3, w2 = F[u2]/(m2 lambda).",
            f"largest error of q3', {window}",
            _peak(printed[late, 2]),
            "rad/s",
            Below(1e-8),
            Above(0.1),
            "q3' = w3 - w2, since m2 q3'' = -u2",
        ),
        Claim(
            "leg, what q3' as printed is",
            f"ours, on {place}",
            "What is printed is q3' + 2 F[u2]/(m2 lambda).",
            f"largest departure from this, {window}",
            _peak(twice[late]),
            "rad/s",
            Below(1e-8),
        ),
        Claim(
            "leg, corrected",
            f"ours, on {place}",
            "With F[1/z1] and the sign corrected, Prop. 4 holds.",
            f"largest error, {window}, filters from zero",
            _peak(corrected[late]),
            MIXED,
            Below(1e-8),
        ),
        *_starts("leg", place, run, "Prop. 4, corrected", s.leg(), (0, 2)),
    ]


def proposition5(run: Simulation) -> list[Claim]:
    """P1 of Prop. 5, from [`ball`][aslo_jax.paper._section4.loops.ball]."""
    late, place = run.t > s.SETTLED, "4.2, Prop. 5, P1"
    return [
        Claim(
            "ball, as printed",
            place,
            "q1' and q2' of the ball and beam are those of Prop. 5.",
            f"largest error, t in [{s.SETTLED:g}, {s.SPAN:g}] s, filters from zero",
            _peak(loops.error(run, "Prop. 5")[late]),
            MIXED,
            Below(1e-8),
        ),
        *_starts("ball", place, run, "Prop. 5", s.ball(), (0,)),
    ]


def _starts(name, place, run, proposition, mechanism, constant) -> list[Claim]:
    later = run.t > 0
    found = loops.error(run, proposition)[:, constant]
    first = np.asarray(mechanism.start.position)[list(constant)]
    speed = np.asarray(mechanism.start.velocity)[list(constant)]
    law = (s.RATE * first - speed) * np.exp(-s.RATE * run.t)[:, None]
    which = " and ".join(f"q{j + 1}'" for j in constant)
    return [
        Claim(
            f"{name}, printed start",
            place,
            "The identity holds for all t > 0.",
            f"largest error of {which}, t >= 1 ms, filters from zero",
            _peak(found[later]),
            MIXED,
            Below(1e-8),
            Near(_peak(law[later]), 1e-2),
            "with the filters from zero there is a transient (lambda q(0) - q'(0)) "
            "exp(-lambda t)",
            f"Largest departure from this law: {_peak((found - law)[later]):.0e}.",
        ),
        Claim(
            f"{name}, exact start",
            f"ours, on {place}",
            "With the exact start the identity holds for all t > 0.",
            "largest error of all velocities, t >= 1 ms",
            _peak(loops.error(run, "ASLO, exact")[later]),
            MIXED,
            Below(1e-8),
        ),
    ]


def asymptotic(name: str, place: str, run: Simulation) -> list[Claim]:
    """P2 of Prop. 4 (the leg) or 5 (the ball)."""
    slow, fast = s.GAINS
    law = f"The error of the A-ASLO of the {name} obeys e' = -gamma e"
    departure = {}
    for start in ("paper", "exact"):
        departure[start] = max(
            _peak(
                loops.error(run, f"A-ASLO {gain:g}, {start}")
                + run.hidden[0] * np.exp(-gain * run.t)[:, None]
            )
            for gain in s.GAINS
        )
    both = f"gamma = {slow:g} and {fast:g}, lambda = {s.RATE:g} rad/s"
    quantity = "decay rate of the error, t in [2.5, 3.5] s, filters from zero"
    return [
        Claim(
            f"{name}, rate, gamma < lambda",
            place,
            f"{law}, here with gamma = {slow:g} and lambda = {s.RATE:g} rad/s.",
            quantity,
            decay_rate(run, f"A-ASLO {slow:g}, paper"),
            "rad/s",
            Near(slow, 0.01),
        ),
        Claim(
            f"{name}, rate, gamma > lambda",
            place,
            f"{law}, here with gamma = {fast:g} and lambda = {s.RATE:g} rad/s.",
            quantity,
            decay_rate(run, f"A-ASLO {fast:g}, paper"),
            "rad/s",
            Near(fast, 0.1),
            Near(s.RATE, 0.05),
            "the rate is min(gamma, lambda)",
            f"With the exact start it is {fast:g} rad/s.",
        ),
        Claim(
            f"{name}, error, printed start",
            place,
            f"{law}, here with {both}.",
            "largest departure from e(0) exp(-gamma t), filters from zero",
            departure["paper"],
            MIXED,
            Below(1e-8),
            Above(0.1),
            "e' = -gamma e + gamma e_ASLO + a(q, v + e_ASLO) - a(q, v)",
            "The acceleration a is taken at the velocities of the ASLO.",
        ),
        Claim(
            f"{name}, error, exact start",
            f"ours, on {place}",
            f"{law}, here with {both}.",
            "largest departure from e(0) exp(-gamma t), exact start",
            departure["exact"],
            MIXED,
            Below(1e-8),
        ),
    ]


def decay_rate(run: Simulation, name: str, t1: float = 2.5, t2: float = 3.5) -> float:
    """Mean decay rate (rad/s) of the first velocity's error between t1 and t2 (s)."""
    error = np.abs(loops.error(run, name)[:, 0])
    first, last = np.searchsorted(run.t, [t1 - 1e-6, t2 - 1e-6])
    return float(np.log(error[first] / error[last]) / (run.t[last] - run.t[first]))


def _peak(error) -> float:
    return float(np.abs(error).max())
