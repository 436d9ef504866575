"""`kind = "magnetic_bearing"`: one axis of an active magnetic bearing."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from .._filters import LowPass
from .._guard import Guard
from ..logs import Log, Signals
from ..observers import AbstractObserver, AlgebraicObserver, BearingObserver, Lifted
from ..plants import MagneticBearing
from ..schema import NoLoad, Numbers, Positive, Table, WaveTable, key
from . import _keys as keys, _lifted, offers
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    Quantity,
    Rate,
    Rates,
    Unknowns,
    certified,
    in_columns,
    relative,
)
from ._condensed import CondensedLog
from ._lifted import ObserverTable, is_lifted, lifted
from ._study import Errors, Explored, Range, Study

# A body at rest shows nothing: the cutoff is below the frequencies at which one moves. With
# 1 mA of noise on 0.5 A, 30 and 200 rad/s gave 2 % of the position and 6 % of the velocity
# of a motion at 40 and 90 rad/s; 80 and 200 gave 4 % and 10 %.
CUTOFF, VELOCITY_CUTOFF = 30.0, 200.0  # rad/s
THRESHOLD = 1e-4
FLUX = ("flux_1", "flux_2")


class MagneticBearingTable(Table):
    """`[machine]` of a magnetic bearing, in SI units."""

    kind: Literal["magnetic_bearing"] = key(
        "the kind of machine", example="magnetic_bearing"
    )
    resistance: Positive | Annotated[list[Positive], Field(min_length=2, max_length=2)] = (
        key(
            "resistance of a coil, of both or of each",
            "ohm",
            example=[2.0, 2.0],
            allowed="a positive finite number, or two, [R1, R2]",
        )
    )
    gap: Positive = key("air gap on each side of the centred body", "m", example=0.5e-3)
    force_constant: Positive = key(
        "k = mu0 N^2 A of the N turns and the area A of a coil", "H m", example=2.0106e-5
    )
    mass: Positive = key("mass of the body", "kg", example=1.0)


class MagneticBearingObserver(ObserverTable):
    """`[observer]` of a magnetic bearing, all optional. The default `threshold` suits
    signals with errors of about 1 %; that of a motor is more than small motions reach."""

    cutoff: Positive | None = keys.cutoff(f"{CUTOFF:g}", example=CUTOFF)
    velocity_cutoff: Positive | None = key(
        f"cutoff of the velocity's filter, by default {VELOCITY_CUTOFF:g}",
        "rad/s",
        default=None,
        example=VELOCITY_CUTOFF,
    )
    completion: Literal["least-squares"] = key(
        "from one row to two",
        default="least-squares",
        because='the determinant of "repeat" changes sign as the body moves',
    )
    threshold: Positive = keys.threshold(THRESHOLD)
    kind: _lifted.ObserverKind = _lifted.kind_key()
    output_deviation: _lifted.Deviation | None = _lifted.deviation_key("currents", 0.01)
    input_deviation: _lifted.Deviation | None = _lifted.deviation_key("voltages", 0.1)
    prior: Positive | None = _lifted.prior_key(0.01)

    @model_validator(mode="after")
    def _begins(self):
        if is_lifted(self) and self.prior is None:
            raise ValueError(
                '`observer.prior` must be given with `observer.kind = "lifted_kalman"` of '
                "a magnetic bearing, whose filter finds the fluxes late without: about "
                "force_constant/(2 gap) times the current (Wb)"
            )
        return self


class BearingStart(Table):
    """The state in which a bearing starts; what is left out is that of the plant."""

    flux: Numbers | None = key("flux of the coils", "Wb", default=None)
    position: float | None = key("position of the body", "m", default=None)
    velocity: float | None = key("velocity of the body", "m/s", default=None)


class SuspensionTable(Table):
    """What acts on a bearing in a study."""

    bias: Positive = key("current of both coils at the start", "A", default=1.0)
    force: WaveTable = key("outer force on the body (N)", default=NoLoad)
    initial: BearingStart = key("the first state", default=BearingStart())


def _suspended(table: Any) -> MagneticBearing:
    settings = table.model_dump(exclude={"kind", "resistance", "force", "initial"})
    resistance = np.asarray(table.resistance, float)
    return MagneticBearing(resistance, **settings, force=table.force.signal())


def _observer(keys: Any, plant: MagneticBearing, start: Any) -> BearingObserver:
    del start
    flux = offers.algebraic_observer(plant.flux_relation(), keys, THRESHOLD)
    return BearingObserver(flux, LowPass(keys.velocity_cutoff))


class MagneticBearingDescription(
    AbstractDescription[MagneticBearingTable, MagneticBearingObserver]
):
    """One axis of a magnetic bearing: fluxes, position and velocity from the voltages and
    currents of its two opposed coils."""

    machine: MagneticBearingTable
    observer: MagneticBearingObserver = MagneticBearingObserver()

    kind = "magnetic_bearing"
    title: ClassVar[str] = "Magnetic bearing"
    layout: ClassVar[Layout] = Layout(
        Signals(
            inputs=("u_1", "u_2"),
            outputs=("i_1", "i_2"),
            truth=(*FLUX, "position", "velocity"),
            note="the position is positive towards coil 1, zero in the middle",
        ),
        (
            Quantity("flux", FLUX, "Wb"),
            Quantity("position", ("position",), "m"),
            Quantity("velocity", ("velocity",), "m/s"),
        ),
    )
    motion = "does the body move, or the common part of the currents vary?"
    residual: ClassVar[str] = (
        "| i1 flux2 + i2 flux1 - (4 g/k) flux1 flux2 | / sum of the sizes"
    )
    refused: ClassVar[Mapping[str, str]] = {
        "pll_bandwidth": "nothing turns in it, so there is no angle to follow; remove it",
        "gain": "its observer has no asymptotic form; remove it",
        "start": "its observer has the exact start only; remove it",
    }
    longest_interval: ClassVar[float] = 5e-3
    unknowns: ClassVar[Unknowns] = Unknowns(
        ("resistance", "gap"), further=("force_constant",)
    )
    study: ClassVar[Study | None] = Study(
        machine=MagneticBearingTable,
        acting=SuspensionTable,
        entries=(*FLUX, "position", "velocity"),
        units=("Wb", "Wb", "m", "m/s"),
        plant=_suspended,
        observers={"aslo": _observer},
        controls=("levitation",),
        explored=Explored(
            run=(
                Range("control.reference.amplitude", "position, swing", "m", 0.0, 2e-4),
                Range("control.reference.frequency", "its frequency", "rad/s", 0.0, 200.0),
                Range("control.ripple", "voltage ripple", "V", 0.0, 30.0),
                Range("machine.force.amplitude", "outer force, swing", "N", 0.0, 15.0),
            ),
            start=(Range("machine.initial.position", "position", "m", -2e-4, 2e-4),),
            outputs=Errors("A", noise=0.05, offset=0.05),
            inputs=Errors("V", noise=1.0, offset=1.0),
            initial={"position": 0.0},
        ),
    )

    def plant(self) -> Any:
        table = self.machine.model_dump(exclude={"kind", "resistance"})
        return MagneticBearing(np.asarray(self.machine.resistance), **table)

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        defaults = {
            "cutoff": Rate(CUTOFF, "by default"),
            "velocity_cutoff": Rate(VELOCITY_CUTOFF, "by default"),
        }
        return {name: rate for name, rate in defaults.items() if name not in stated}

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        velocity = LowPass(rates["velocity_cutoff"].constant)
        if is_lifted(self.observer):
            flux = lifted(self.plant().flux_relation(), self.observer)
            assert isinstance(flux, Lifted), "bearings offer no other kind"
            return BearingObserver(flux, velocity, Guard(THRESHOLD))
        guard = Guard(threshold=self.observer.threshold)
        flux = AlgebraicObserver(
            self.plant().flux_relation(), LowPass(rates["cutoff"].constant), guard=guard
        )
        return BearingObserver(flux, velocity, guard)

    def columns(self, estimate: Any, log: Log) -> Columns:
        names = (*FLUX, "position", "velocity")
        return in_columns(names, estimate.value) | certified(estimate)

    def truth(self, log: Log) -> Columns:
        return log.truth

    def residuals(self, columns: Columns, log: Log) -> Columns:
        flux_1, flux_2 = (columns[name] for name in FLUX)
        one, two = log.y[:, 0] * flux_2, log.y[:, 1] * flux_1
        both = 4.0 * self.machine.gap / self.machine.force_constant * flux_1 * flux_2
        size = np.abs(one) + np.abs(two) + np.abs(both)
        return {"flux": relative(one + two - both, size)}
