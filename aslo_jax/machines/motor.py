"""What motors with magnets share: columns, rates, the angle of the magnet; and all of the
description of one without saliency."""

import abc
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field, model_validator

from .._checks import real
from .._module import Module
from .._typing import PyTree
from ..logs import Log, Signals
from ..observers import AbstractObserver
from ..plants import AbstractRoundMachine
from ..schema import NoLoad, NonNegative, Numbers, Positive, Table, WaveTable, key
from . import _keys as keys, _lifted
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    MachineError,
    Quantity,
    algebraic,
    certified,
    in_columns,
)
from ._condensed import CondensedLog
from ._lifted import (
    ObserverTable,
    deviations_of,
    is_adaptive,
    is_lifted,
    lifted,
    parameters_of,
    turning_deviation,
)
from ._noise import Noise, white_noise
from ._rates import PACE, PerSpeedTable, Rate, Rates
from ._speed import (
    CUTOFF,
    FORGETTING,
    cutoff_for,
    median_interval,
    slow_speed,
    turning_acceleration,
    turning_speed,
    two_rates,
)

PLL_BANDWIDTH = 100.0  # rad/s, unless the log accelerates fast
BLOCKS = 25  # of a log, whose mean speeds tell how the speed varies
LAG = 0.3  # rad: what the angle of a loop may lag by at the acceleration of the log
FASTEST = 10.0  # times the typical speed: none in a log is faster
RANGE = 2.0  # of what forgetting two speeds of a log want, from which on it varies
LONGEST_INTERVAL = 5e-3  # s: 200 Hz, or 200 kHz with time in milliseconds

FLUX = ("flux_alpha", "flux_beta")
ANGLE, SPEED = "theta_electrical", "omega_electrical"
LAYOUT = Layout(
    Signals(truth=(*FLUX, ANGLE, "theta_mechanical", SPEED, "omega_mechanical")),
    (
        Quantity("flux", FLUX, "Wb", turns=True),
        Quantity("angle", (ANGLE,), "rad", angle=True),
        Quantity("speed", (SPEED,), "rad/s", tracks=ANGLE),
    ),
)


_PARAMETERS, _DEVIATIONS, _DRIFT, _HOLD, _BANK, _TOLERANCE = _lifted.adaptive_keys()


class MotorObserver(ObserverTable):
    """`[observer]` of a motor without saliency, all optional.

    The default `threshold` suits signals with errors of about 3 % or less, which includes
    the discretisation of a log: the first instants after the start have certificates from
    1e-7 to 1e-3 and errors above 1 %.
    """

    cutoff: Positive | PerSpeedTable | None = keys.cutoff(allowed=PACE)
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold()
    pll_bandwidth: Positive | None = keys.pll_bandwidth()
    kind: _lifted.MotorKind = _lifted.kind_key()
    output_deviation: _lifted.Deviation | None = _lifted.deviation_key("currents", 0.01)
    input_deviation: _lifted.Deviation | None = _lifted.deviation_key("voltages", 0.1)
    prior: Positive | None = _lifted.prior_key(0.2)
    forgetting: Positive | PerSpeedTable | None = keys.forgetting(allowed=PACE)
    parameters: list[_lifted.Parameter] = _PARAMETERS
    deviations: list[Positive] = _DEVIATIONS
    drift: NonNegative = _DRIFT
    hold: Positive = _HOLD
    bank: Annotated[int, Field(ge=3)] = _BANK
    tolerance: Positive = _TOLERANCE

    @model_validator(mode="after")
    def _forgets(self):
        if self.forgetting is not None and self.completion == "repeat":
            raise ValueError(
                '`observer.forgetting` is for `observer.completion = "least-squares"`; '
                "remove it"
            )
        return self


class RotorStart(Table):
    """The state in which a machine starts; what is left out is that of the plant."""

    flux: Numbers | None = key("flux of the windings", "Wb", default=None)
    speed: float | None = key("mechanical speed", "rad/s", default=None)
    angle: float | None = key("mechanical angle", "rad", default=None)


class RotorTable(Table):
    """What acts on a machine that turns, in a study."""

    friction: NonNegative = key("viscous friction", "N m s/rad", default=0.0)
    load: WaveTable = key("load torque (N m)", default=NoLoad)
    initial: RotorStart = key("the first state", default=RotorStart())


def with_load(plant: Any, table: Any) -> Any:
    """The machine of a study: of the class `plant`, with friction and load."""
    settings = table.model_dump(exclude={"kind", "load", "initial"})
    return plant(**settings, load=table.load.signal())


def driving(log: Log, resistance: float, noise: Noise | None = None) -> CondensedLog:
    """A log of the derivative of the flux, `u - R i` (V), alone, and its `noise`."""
    with np.errstate(over="ignore"):
        v = log.u - resistance * log.y
    if not np.isfinite(v[np.isfinite(log.u).all(1) & np.isfinite(log.y).all(1)]).all():
        raise MachineError(
            f"`machine.resistance` of {resistance:.4g} ohm makes a voltage of the log's "
            "currents that is no finite number; check its unit."
        )
    return CondensedLog(log.t, v, np.zeros((log.t.size, 0)), {}, noise=noise)


def motor_rates(log: Log | None, stated: Mapping[str, Any]) -> Rates:
    """The rates of a motor's observer that are not `stated`, from a log of [`driving`][].

    A loop with a bandwidth above half of the sampling rate only passes noise on: the
    default gives way to that, a stated bandwidth is refused."""
    rates: Rates = {}
    interval = 0.0 if log is None else median_interval(log.t)
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


def motor_columns(
    estimate: Any, magnet: Float[np.ndarray, "N 2"], inductance: float, settings: Any
) -> Columns:
    """The columns of a motor whose magnet, or active flux, is `magnet` (Wb), the flux less
    `inductance` times the current."""
    angle = np.unwrap(np.arctan2(magnet[:, 1], magnet[:, 0]))
    found = in_columns(FLUX, estimate.value) | {ANGLE: angle} | certified(estimate)
    if estimate.covariance is None:
        return found
    noise = inductance * np.asarray(settings.output_deviation)
    deviation = turning_deviation(estimate, magnet, noise)
    found |= deviations_of(FLUX, estimate) | {f"deviation_{ANGLE}": deviation}
    names = settings.parameters if is_adaptive(settings) else ()
    return found | parameters_of(names, estimate)


class MagnetAngle(Module):
    """The angle of the magnet, or of the active flux (rad, wrapped), from the flux that is
    estimated, less `inductance` (H) times the current."""

    inductance: Float[Array, ""] = eqx.field(converter=real)

    def __call__(
        self, u: PyTree, y: Float[Array, " 2"], estimate: Any
    ) -> tuple[PyTree, Float[Array, ""]]:
        magnet = estimate.value - self.inductance * y
        return u, jnp.arctan2(magnet[1], magnet[0])


def motor_truth(log: Log, pole_pairs: int) -> Columns:
    """The truth, with the electrical angle and speed from the mechanical ones unless they
    are given."""
    truth = dict(log.truth)
    for name, electrical in (("theta_mechanical", ANGLE), ("omega_mechanical", SPEED)):
        if name in truth:
            truth.setdefault(electrical, pole_pairs * truth.pop(name))
    return {name: truth[name] for name in (*FLUX, ANGLE, SPEED) if name in truth}


def flux_of(columns: Columns) -> Float[np.ndarray, "N 2"]:
    """The flux of a table of estimates (Wb)."""
    return np.stack([columns[name] for name in FLUX], axis=1)


M = TypeVar("M", bound=Table)


class AbstractRoundMotor(AbstractDescription[M, MotorObserver], abc.ABC, Generic[M]):
    """A motor with a magnet and no saliency: flux, angle and speed from voltages and
    currents. `[machine]` has the keys `resistance`, `inductance` and `pole_pairs`."""

    observer: MotorObserver = MotorObserver()

    layout: ClassVar[Layout] = LAYOUT
    motion = "does the motor turn?"
    refused: ClassVar[Mapping[str, str]] = {}
    longest_interval: ClassVar[float] = LONGEST_INTERVAL

    @abc.abstractmethod
    def plant(self) -> AbstractRoundMachine:
        """The motor described by `[machine]`."""

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        rates = motor_rates(log, stated)
        if log is None:
            return rates
        loop = rates.get("pll_bandwidth") or Rate(stated["pll_bandwidth"])
        return rates | self._two_rates(log, stated, loop.constant)

    def condensed(self, log: Log) -> CondensedLog:
        noise = None
        if self._has_two_rates(self.stated()):
            noise = white_noise(log.u, log.y, *self.noise_groups())
        return driving(log, self._values().resistance, noise)

    def _has_two_rates(self, stated: Mapping[str, Any]) -> bool:
        settings = self.observer
        plain = settings.completion == "least-squares" and settings.start == "exact"
        return plain and not {"cutoff", "forgetting", "gain"} & stated.keys()

    def _two_rates(
        self, log: CondensedLog, stated: Mapping[str, Any], bandwidth: float
    ) -> Rates:
        """Cutoff and forgetting for a log with noise, where they are left to it; the latter
        follows the speed, by a loop of that `bandwidth` (rad/s), where that varies."""
        found = log.noise
        if found is None or not self._has_two_rates(stated):
            return {}
        if found.least_output:  # what sampling leaves wants other rates than noise does
            return {}
        values, (of_y, of_u) = self._values(), (found.output[0], found.input[0])
        seen = 2.0**0.5 * values.inductance * of_y
        drift = float(np.hypot(of_u, values.resistance * of_y) / seen)
        speed = slow_speed(log.t, log.u, float(self.plant().magnet_flux))
        cutoff, forgetting = two_rates(speed, drift)
        noise = f"noise of {of_y:.2g} A and {of_u:.2g} V"
        why = f"for {speed:.4g} rad/s, and {noise}"
        fast = turning_speed(log.t, log.u)
        if two_rates(fast, drift)[1] < RANGE * forgetting:
            return {"cutoff": Rate(cutoff, why), "forgetting": Rate(forgetting, why)}
        # At every speed what a log of that one would have.
        wide = f"for speeds from {speed:.4g} to {fast:.4g} rad/s, and {noise}"
        follow = lambda per_speed, low, high: Rate(
            PerSpeedTable(per_speed=per_speed, low=low, high=high, bandwidth=bandwidth),
            wide,
        )
        return {
            "cutoff": follow(CUTOFF, cutoff, CUTOFF * FASTEST * fast),
            "forgetting": follow(
                FORGETTING, forgetting, max(FORGETTING * drift, forgetting)
            ),
        }

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings = self.observer
        relation = self.plant().flux_relation()
        if is_lifted(settings):
            return lifted(relation, settings)
        return algebraic(
            relation,
            rates["cutoff"],
            threshold=settings.threshold,
            completion=settings.completion,
            start=settings.start,
            gain=rates.get("gain"),
            forgetting=rates.get("forgetting"),
        )

    def columns(self, estimate: Any, log: Log) -> Columns:
        inductance = self._values().inductance
        magnet = np.asarray(estimate.value) - inductance * log.y
        return motor_columns(estimate, magnet, inductance, self.observer)

    def followed(self) -> MagnetAngle:
        return MagnetAngle(self._values().inductance)

    def truth(self, log: Log) -> Columns:
        return motor_truth(log, self._values().pole_pairs)

    def residuals(self, columns: Columns, log: Log) -> Columns:
        magnet = flux_of(columns) - self._values().inductance * log.y
        size = np.linalg.norm(magnet, axis=1)
        return {"flux": np.abs(size / float(self.plant().magnet_flux) - 1.0)}

    def operation(self, columns: Columns, log: Log) -> dict[str, float]:
        rows = columns["coasting"] == 0
        plant, t = self.plant(), log.t[rows]
        if t.size < 4 * BLOCKS:
            return {}
        angle = columns[ANGLE][rows] / plant.pole_pairs
        # Of blocks, in which the noise of the angle is small beside its way.
        edges = np.linspace(0, t.size - 1, BLOCKS + 1).astype(int)
        speeds = np.diff(angle[edges]) / np.diff(t[edges])
        middles = 0.5 * (t[edges][1:] + t[edges][:-1])
        gained = (speeds[-1] - speeds[0]) / (middles[-1] - middles[0])
        flux, current = flux_of(columns)[rows].T, log.y[rows].T
        crossed = np.mean(flux[0] * current[1] - flux[1] * current[0])
        torque = float(plant.torque_factor) * plant.pole_pairs * crossed
        mean = (angle[-1] - angle[0]) / (t[-1] - t[0])
        sign = -1.0 if mean < 0 else 1.0
        return {
            "speed": sign * float(mean),
            "swing": float(np.sqrt(2.0) * np.std(speeds)),
            "torque": sign * float(torque - float(plant.inertia) * gained),
        }

    def _values(self) -> Any:
        return self.machine
