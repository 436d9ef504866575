"""The settings of the paper's section 3, and the observers that its claims are about."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._completions import AbstractCompletion, Repeat
from ..._filters import LowPass
from ..._guard import Guard
from ..._relations import AbstractTerms
from ..._typing import FilterStart, Winding
from ...observers import FO1, FO2, FO3, AlgebraicObserver, Asymptotic
from ...plants import PMSM, WRIM, FluxRelation, WindingFluxRelation

RATE, GAIN = 5.0, 5.0  # lambda and gamma "for all observers" (rad/s; FO1 to FO3: SI)
LARGE_GAIN = 1000.0  # gamma that FO2 needs (1/(s Wb^2))
SPAN = 10.0  # of the closed loop (s)
CURRENT_LIMIT = 2.3  # Table 1 (A)
MAGNET = 0.2086  # lambda_m of Table 1 (Wb)
LARGEST_LOAD = 3.5  # of the load below (N m)
SLOW, FAST = 2.0, 20.0  # gamma of the A-ASLO below and above lambda (rad/s)
# The footnote of Prop. 2 lets the estimate be frozen where Delta vanishes: below this
# certificate, which is about the square of the relative Delta.
FREEZE = 1e-6
REVERSAL_SPAN, INTERVAL = 8.0, 1e-4  # of the sampled reversal, and between samples (s)
CURRENT_NOISE, VOLTAGE_NOISE = 0.01, 0.1  # standard deviations (A, V)
THRESHOLD = 1e-3  # of the guard under this noise
QUICK = 50.0  # a second lambda of the reversal (rad/s)

Relation = Callable[..., AbstractTerms]


def motor(**changes) -> PMSM:
    """The motor of Table 1 under the paper's load, with the torque of 3/2."""
    return PMSM.bmp0701f(**(dict(load=load) | changes))


def load(t: Float[Array, ""]) -> Float[Array, ""]:
    """`3 + 0.5 sin 0.1 t` (N m), t in s."""
    return 3.0 + 0.5 * jnp.sin(0.1 * t)


def reference(t: Float[Array, ""]) -> Float[Array, ""]:
    """`2 + 0.5 sin t` (rad/s), t in s."""
    return 2.0 + 0.5 * jnp.sin(t)


def reversing(t: Float[Array, ""]) -> Float[Array, ""]:
    """`2 sin t` (rad/s), t in s."""
    return 2.0 * jnp.sin(t)


def aslo(
    relation: Relation,
    rate: float = RATE,
    start: FilterStart = "paper",
    completion: AbstractCompletion | None = None,
    threshold: float | None = None,
) -> AlgebraicObserver:
    """The ASLO of a relation, lambda = `rate` (rad/s); by default that of Prop. 2, raw.

    The exact start is always guarded, since at t = 0 there is no estimate; a `threshold`
    guards the other one too."""
    guard = None if start == "paper" and threshold is None else Guard(threshold)
    completion = Repeat() if completion is None else completion
    return AlgebraicObserver(relation, LowPass(rate), completion, guard, start)


def a_aslo(
    relation: Relation,
    gain: float = GAIN,
    rate: float = RATE,
    start: FilterStart = "paper",
    completion: AbstractCompletion | None = None,
    initial: Float[np.ndarray, " n"] | None = None,
) -> Asymptotic:
    """The A-ASLO of P2, gamma = `gain` (rad/s), frozen as in the footnote of Prop. 2. It
    starts at `initial`, or at the first certified instant where that is `None`."""
    threshold = FREEZE if start == "paper" else None
    inner = aslo(relation, rate, start, completion, threshold)
    return Asymptotic(inner, gain, initial)


def fo1(relation: FluxRelation, gain: float = GAIN) -> FO1:
    """FO1 as printed, but for its stray c."""
    return FO1(relation, LowPass(RATE), gain, "paper")


def fo2(relation: FluxRelation, gain: float = GAIN) -> FO2:
    """FO2 as printed."""
    return FO2(relation, gain)


def fo3(relation: FluxRelation, gain: float = GAIN, start: FilterStart = "paper") -> FO3:
    """FO3 as printed."""
    return FO3(relation, LowPass(RATE), gain, start)


def printed_winding(machine: WRIM, winding: Winding) -> WindingFluxRelation:
    """The relation of Prop. 3, with L_s for both windings."""
    right = machine.flux_relation(winding)
    return WindingFluxRelation(
        winding, right.resistance, machine.stator_inductance, machine.mutual_inductance
    )


def printed_angle(
    flux: np.ndarray, current: np.ndarray, inductance: float, pole_pairs: int
) -> np.ndarray:
    """The rotor angle (rad) of O7: the arctangent of a quotient, over the pole pairs."""
    a, b = np.moveaxis(inductance * current - flux, -1, 0)
    return np.arctan(b / a) / pole_pairs


class Printed(NamedTuple):
    """What the claims of section 3 are about, as functions of their gains."""

    aslo: Callable[..., AlgebraicObserver] = aslo
    a_aslo: Callable[..., Asymptotic] = a_aslo
    fo1: Callable[..., FO1] = fo1
    fo2: Callable[..., FO2] = fo2
    fo3: Callable[..., FO3] = fo3
    winding: Callable[[WRIM, Winding], WindingFluxRelation] = printed_winding
    angle: Callable[..., np.ndarray] = printed_angle
