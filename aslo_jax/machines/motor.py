"""What PMSM, stepper and interior PMSM share: columns, rates, the angle of a magnet."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..logs import Log, Signals
from . import keys
from .base import (
    Columns,
    Layout,
    MachineError,
    Positive,
    Quantity,
    Rate,
    Rates,
    Table,
    certified,
    in_columns,
)
from .speed import cutoff_for, turning_acceleration, turning_speed

PLL_BANDWIDTH = 100.0  # rad/s, unless the log accelerates fast
LAG = 0.3  # rad: what the angle of a loop may lag by at the acceleration of the log
LONGEST_INTERVAL = 5e-3  # s: 200 Hz, or 200 kHz with time in milliseconds

FLUX = ("flux_alpha", "flux_beta")
ANGLE, SPEED = "theta_electrical", "omega_electrical"
LAYOUT = Layout(
    Signals(truth=(*FLUX, ANGLE, SPEED, "omega_mechanical")),
    (
        Quantity("flux", FLUX, "Wb", turns=True),
        Quantity("angle", (ANGLE,), "rad", angle=True),
        Quantity("speed", (SPEED,), "rad/s", tracks=ANGLE),
    ),
)


class MotorObserver(Table):
    """`[observer]` of a motor without saliency, all optional.

    The default `threshold` suits signals with errors of about 3 % or less, which includes
    the discretisation of a log: the first instants after the start have certificates from
    1e-7 to 1e-3 and errors above 1 %.
    """

    cutoff: Positive | None = keys.cutoff()
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold()
    pll_bandwidth: Positive | None = keys.pll_bandwidth()


def driving(log: Log, resistance: float) -> Log:
    """A log of the derivative of the flux, `u - R i` (V), alone."""
    v = log.u - resistance * log.y
    return Log(log.t, v, np.zeros((log.t.size, 0)), {})


def motor_rates(log: Log | None, stated: Mapping[str, float]) -> Rates:
    """The rates of a motor's observer that are not `stated`, from a log of [`driving`][].

    A loop with a bandwidth above half of the sampling rate only passes noise on: the
    default gives way to that, a stated bandwidth is refused."""
    rates: Rates = {}
    interval = 0.0 if log is None else float(np.median(np.diff(log.t)))
    fastest = 0.5 / interval if interval else np.inf
    if "pll_bandwidth" not in stated:
        rates["pll_bandwidth"] = _bandwidth(log, fastest)
    elif stated["pll_bandwidth"] > fastest:
        raise MachineError(
            f"the bandwidth of the phase-locked loop must be at most {fastest:.4g} rad/s "
            f"for the sampling interval of this log, {interval:.4g} s, but is "
            f"{stated['pll_bandwidth']:.4g}; lower --pll-bandwidth or "
            "`observer.pll_bandwidth`, and check that `t` is in seconds."
        )
    if "cutoff" not in stated and log is not None:
        speed = turning_speed(log.t, log.u)
        rates["cutoff"] = Rate(
            cutoff_for(speed), f"for the log's electrical speed of {speed:.4g} rad/s"
        )
    return rates


def _bandwidth(log: Log | None, fastest: float) -> Rate:
    """The lag of a loop of bandwidth b at the acceleration al is `al / b^2`."""
    if log is None or log.u.shape[1] != 2:
        return Rate(min(PLL_BANDWIDTH, fastest))
    acceleration = turning_acceleration(log.t, log.u)
    wanted = (acceleration / LAG) ** 0.5
    if wanted <= PLL_BANDWIDTH:
        return Rate(min(PLL_BANDWIDTH, fastest))
    why = f"for the log's electrical acceleration of {acceleration:.4g} rad/s^2"
    return Rate(min(wanted, fastest), why)


def motor_columns(estimate: Any, magnet: Float[np.ndarray, "N 2"]) -> Columns:
    """The columns of a motor whose magnet, or active flux, is `magnet` (Wb)."""
    angle = np.unwrap(np.arctan2(magnet[:, 1], magnet[:, 0]))
    return in_columns(FLUX, estimate.value) | {ANGLE: angle} | certified(estimate)


def motor_truth(log: Log, pole_pairs: int) -> Columns:
    """The truth, with the electrical speed from the mechanical one unless it is given."""
    truth = dict(log.truth)
    if "omega_mechanical" in truth:
        truth.setdefault(SPEED, pole_pairs * truth["omega_mechanical"])
        del truth["omega_mechanical"]
    return {name: truth[name] for name in (*FLUX, ANGLE, SPEED) if name in truth}


def flux_of(columns: Columns) -> Float[np.ndarray, "N 2"]:
    """The flux of a table of estimates (Wb)."""
    return np.stack([columns[name] for name in FLUX], axis=1)
