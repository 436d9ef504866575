"""Claims of the paper's O2 and of the footnote of 2.3: observers as linear systems."""

import math

import numpy as np

from ..._filters import second_order
from ...observers import SteadyStateKalman
from .._claims import Above, Below, Claim, Near
from .._linear import realisation
from . import experiments as s

W, V = 1.0, 0.01  # intensities of the noises on u (m^2/s^3) and y (m^2 s)


def realisations(printed: s.Printed) -> list[Claim]:
    """O2: the three state-space forms, and the resemblance of two of them."""
    lam, gamma = s.RATE, s.GAIN
    algebraic = realisation(printed.aslo(lam))
    asymptotic = realisation(printed.a_aslo(lam, gamma))
    peer = realisation(printed.luenberger(lam))
    forms = [
        (algebraic, np.diag([-lam, -lam]), [[lam, 0], [0, -(lam**2)]], [1 / lam, 1], lam),
        (
            asymptotic,
            np.array([[-lam, 0, 0], [0, -lam, 0], [gamma / lam, gamma, -gamma]]),
            [[lam, 0], [0, -(lam**2)], [1, gamma * lam]],
            [0, 0, 1],
            0.0,
        ),
        (peer, np.array([[-lam]]), [[1, -(lam**2)]], [1], lam),
    ]
    frequency = np.logspace(-2, 2, 41)
    gap = max(
        np.abs(
            ours.response(frequency)
            - type(ours)(A, np.array(B), np.array([C]), np.array([[0, D]])).response(
                frequency
            )
        ).max()
        for ours, A, B, C, D in forms
    )
    ratio = asymptotic.variance(W, 0.0) / algebraic.variance(W, 0.0)
    return [
        Claim(
            "state-space forms",
            "2.4, eqs (aslorea), (staspaasyobsx2), (lueobs)",
            "The three observers have these realisations.",
            "largest difference of frequency responses, 0.01 to 100 rad/s",
            float(gap),
            "",
            Below(1e-11),
        ),
        Claim(
            "resemblance to Luenberger",
            "2.4, O2",
            "There is absolutely no resemblance of the ASLO and the A-ASLO with the "
            "Luenberger observer.",
            "largest relative difference of frequency responses, gamma_L = lambda",
            float(
                np.abs(algebraic.response(frequency) / peer.response(frequency) - 1).max()
            ),
            "",
            Above(1e-2),
            Below(1e-11),
            "ASLO and Luenberger observer have the same transfer function "
            "(u + lambda p y)/(p + lambda)",
        ),
        Claim(
            "order of the ASLO",
            "ours, on 2.4, O2",
            "The ASLO is a non-minimal realisation of the Luenberger observer.",
            "McMillan degree of its two states",
            float(algebraic.degree()),
            "",
            Near(1, 0),
        ),
        Claim(
            "noise on u, in theory",
            "2.4, O2",
            "The A-ASLO is expected to be more sensitive to input noise.",
            "variance of the A-ASLO over that of the ASLO, lambda = 3, gamma = 2",
            ratio,
            "",
            Above(1.0),
            remark="(lambda^2 + 3 gamma lambda + gamma^2)/(gamma (gamma + lambda)) = 3.1.",
        ),
    ]


def other_filters(printed: s.Printed) -> list[Claim]:
    """The footnote of 2.3, by Lyapunov's equation on the observers' own dynamics."""
    from scipy.optimize import minimize

    def variance(log_gains):
        lam, gamma = np.exp(log_gains)
        return realisation(printed.a_aslo(lam, gamma)).variance(W, V)

    best = minimize(
        variance, [0.5, 1.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12}
    )
    lam, gamma = np.exp(best.x)
    natural = (W / V) ** 0.25
    second = realisation(printed.filtered(second_order(natural)))
    A, B, C = np.eye(2, k=1), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    kalman = realisation(
        SteadyStateKalman.design(A, B, C, W, V, select=np.array([[0.0, 1.0]]))
    )
    frequency = np.logspace(-2, 3, 51)
    gap = np.abs(second.response(frequency) - kalman.response(frequency)).max()
    place = "2.3, footnote"
    footnote = "There is no clear advantage in any other filter than the first-order one."
    noises = "white noise W = 1 on u, V = 0.01 on y"
    optimum = (5 * W / (3 * V)) ** 0.25
    least = kalman_variance()
    return [
        Claim(
            "ASLO, first-order filter",
            place,
            footnote,
            f"variance over that with the second-order filter, {noises}",
            realisation(printed.aslo(s.RATE)).variance(W, V) / second.variance(W, V),
            "",
            Below(1.05),
            Above(1e9),
            "the bare first-order ASLO feeds the noise of y through; its variance is "
            "infinite, a second-order filter's finite",
        ),
        Claim(
            "A-ASLO, best first-order",
            place,
            footnote,
            f"least variance over gamma and lambda, {noises}",
            float(best.fun),
            "(m/s)^2",
            Below(least * (1 + 1e-6)),
            Near(printed_variance(optimum, optimum), 1e-6),
            "even at its best it has 3.7 % more variance than the second-order filter",
        ),
        Claim(
            "A-ASLO, best gain",
            f"ours, on {place}",
            "The least variance is at lambda = gamma = (5 W/(3 V))^(1/4).",
            f"the gain, where |lambda - gamma| = {abs(lam - gamma):.0e} rad/s",
            float(np.sqrt(lam * gamma)),
            "rad/s",
            Near(optimum, 1e-3),
        ),
        Claim(
            "A-ASLO, the paper's gains",
            place,
            footnote,
            f"variance with lambda = 3 and gamma = 2, {noises}",
            realisation(printed.a_aslo(s.RATE, s.GAIN)).variance(W, V),
            "(m/s)^2",
            Below(least * (1 + 1e-6)),
            Near(printed_variance(s.RATE, s.GAIN), 1e-9),
            "24 % more variance than the second-order filter",
        ),
        Claim(
            "ASLO, second-order filter",
            f"ours, on {place}",
            "Its variance is the least of all observers, sqrt(2) W^(3/4) V^(1/4).",
            f"variance with w0 = (W/V)^(1/4), zeta = sqrt(1/2), {noises}",
            second.variance(W, V),
            "(m/s)^2",
            Near(least, 1e-9),
            remark="The steady-state Kalman filter, by Riccati's equation: "
            f"{kalman.variance(W, V):.5f}.",
        ),
        Claim(
            "second-order filter, Kalman",
            place,
            footnote,
            "largest difference of frequency responses to the steady-state Kalman filter",
            float(gap),
            "",
            Above(1e-2),
            Below(1e-10),
            "with a second-order filter the ASLO is the steady-state Kalman filter",
        ),
    ]


def variances(printed: s.Printed, gains: np.ndarray) -> np.ndarray:
    """The A-ASLO's error variance under W and V ((m/s)^2) at each lambda = gamma of
    `gains` (rad/s)."""
    return np.array([realisation(printed.a_aslo(g, g)).variance(W, V) for g in gains])


def printed_variance(lam: float, gamma: float) -> float:
    """The A-ASLO's error variance under W and V in closed form ((m/s)^2), gains in rad/s.

    Source: theory, section 4.
    """
    total, product = gamma + lam, gamma * lam
    return (V * product**2 + W) / (2 * total) + W * total / (2 * product)


def kalman_variance() -> float:
    """The least error variance of all observers under W and V ((m/s)^2).

    Source: theory, section 4.
    """
    return math.sqrt(2) * W**0.75 * V**0.25
