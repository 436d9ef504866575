"""`kind = "wrim"`: the wound-rotor induction machine."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ..diagnosis import Circle
from ..logs import Log, Signals
from ..observers import AbstractObserver, SideBySide
from ..plants import WRIM, WindingFluxRelation
from ..schema import Positive, Table, Whole, key
from . import _keys as keys, _lifted, motor, offers
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    Quantity,
    Rate,
    Rates,
    Unknowns,
    algebraic,
    certified,
    in_columns,
    length,
    relative,
)
from ._condensed import CondensedLog
from ._lifted import ObserverTable, deviations_of, is_lifted, lifted
from ._speed import cutoff_for, turning_speed
from ._study import Errors, Explored, Range, Study

NO_ANGLE = "the table has no angle that a phase-locked loop could follow; remove it"
STATOR, ROTOR = ("flux_s_alpha", "flux_s_beta"), ("flux_r_alpha", "flux_r_beta")


class WRIMTable(Table):
    """`[machine]` of a wound-rotor induction machine, in SI units; rotor quantities the
    rotor's own or referred to the stator, all in one way."""

    kind: Literal["wrim"] = key("the kind of machine", example="wrim")
    stator_resistance: Positive = key("resistance of a stator phase", "ohm", example=2.6e-3)
    rotor_resistance: Positive = key("resistance of a rotor phase", "ohm", example=2.9e-3)
    stator_inductance: Positive = key("inductance Ls of the stator", "H", example=2.587e-3)
    rotor_inductance: Positive = key("inductance Lr of the rotor", "H", example=2.587e-3)
    mutual_inductance: Positive = key("stator to rotor", "H", example=2.5e-3)
    pole_pairs: Whole = key("number of pole pairs", example=2)
    inertia: Positive = key("inertia of the rotor", "kg m^2", example=127.0)

    @model_validator(mode="after")
    def _leak(self):
        limit = math.sqrt(self.stator_inductance * self.rotor_inductance)
        if self.mutual_inductance >= limit:
            raise ValueError(
                "`machine.mutual_inductance`, stator to rotor (H), must be below the "
                "square root of stator_inductance * rotor_inductance, "
                f"{limit:.6g}, but is {self.mutual_inductance!r}"
            )
        return self


class WRIMObserver(ObserverTable):
    """`[observer]` of a wound-rotor induction machine, all optional.

    Fluxes turn at the frequency of the supply in the stator's frame and at that of the slip
    in the rotor's, so each has a cutoff.
    """

    cutoff: Positive | None = keys.cutoff("from the log, for each winding")
    rotor_cutoff: Positive | None = key(
        "cutoff of the rotor's filter where it is another one",
        "rad/s",
        default=None,
        example=20.0,
    )
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold()
    kind: _lifted.ObserverKind = _lifted.kind_key()
    output_deviation: _lifted.Deviation | None = _lifted.deviation_key("currents", 0.01)
    input_deviation: _lifted.Deviation | None = _lifted.deviation_key("voltages", 0.1)
    prior: Positive | None = _lifted.prior_key(1.0)


def _relations(machine: WRIM) -> tuple[WindingFluxRelation, WindingFluxRelation]:
    return machine.flux_relation("stator"), machine.flux_relation("rotor")


class WRIMDescription(AbstractDescription[WRIMTable, WRIMObserver]):
    """A wound-rotor induction machine: stator and rotor flux, each in the frame of its
    winding, from voltages and currents of both windings."""

    machine: WRIMTable
    observer: WRIMObserver = WRIMObserver()

    kind = "wrim"
    title: ClassVar[str] = "Wound-rotor induction machine"
    layout: ClassVar[Layout] = Layout(
        Signals(
            inputs=("u_s_alpha", "u_s_beta"),
            optional=("u_r_alpha", "u_r_beta"),
            outputs=("i_s_alpha", "i_s_beta", "i_r_alpha", "i_r_beta"),
            truth=(*STATOR, *ROTOR),
            note="amplitude-invariant; stator quantities in the stationary frame, rotor "
            "quantities in that of the rotor, which turns by the electrical angle",
        ),
        (
            Quantity("stator flux", STATOR, "Wb", suffix="_s", turns=True),
            Quantity("rotor flux", ROTOR, "Wb", suffix="_r", turns=True),
        ),
    )
    motion = "is it supplied, and does its flux turn in the frame of that winding?"
    residual: ClassVar[str] = "| |flux_k - L_k i_k| - L_sr |i_other| | / |flux_k|"
    refused: ClassVar[Mapping[str, str]] = {"pll_bandwidth": NO_ANGLE}
    longest_interval: ClassVar[float] = 5e-3
    unknowns: ClassVar[Unknowns] = Unknowns(
        (
            "stator_resistance",
            "rotor_resistance",
            "stator_inductance",
            "rotor_inductance",
            "mutual_inductance",
        )
    )
    study: ClassVar[Study | None] = Study(
        machine=WRIMTable,
        acting=motor.RotorTable,
        entries=(*STATOR, *ROTOR),
        units=("Wb",) * 4,
        plant=lambda table: motor.with_load(WRIM, table),
        observers=offers.algebraic(_relations)
        | offers.integrator(_relations)
        | offers.lifted(_relations)
        | offers.mixing(_relations),
        controls=("open_loop",),
        explored=Explored(
            run=(
                Range("control.signal.amplitude", "supply, amplitude", "V", 1.0, 60.0),
                Range("control.signal.frequency", "its frequency", "rad/s", 1.0, 100.0),
                Range("control.signal.depth", "modulation, depth", "", 0.0, 0.8),
                Range("control.signal.rate", "its frequency", "rad/s", 0.0, 20.0),
                Range("machine.load.offset", "load torque", "N m", 0.0, 10.0),
            ),
            start=(
                Range("machine.initial.speed", "speed", "rad/s", -80.0, 80.0),
                Range("machine.initial.angle", "rotor angle", "rad", -3.0, 3.0),
            ),
            outputs=Errors("A", noise=0.5, offset=0.5),
            inputs=Errors("V", noise=2.0, offset=2.0),
            initial={"speed": 0.0, "angle": 0.0},
        ),
    )

    def plant(self) -> Any:
        return WRIM(**self.machine.model_dump(exclude={"kind"}))

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        if "cutoff" in stated:
            rotor = stated.get("rotor_cutoff", stated["cutoff"])
            return {} if "rotor_cutoff" in stated else {"rotor_cutoff": Rate(rotor)}
        if log is None:
            return {}
        stator = turning_speed(log.t, log.u[:, :2])
        rotor = turning_speed(log.t, log.u[:, 2:])
        why = "for {} rad/s, the typical frequency of u - R i there".format
        rates = {"cutoff": Rate(cutoff_for(stator), why(f"{stator:.4g}"))}
        if "rotor_cutoff" not in stated:
            rates["rotor_cutoff"] = Rate(cutoff_for(rotor), why(f"{rotor:.4g}"))
        return rates

    def noise_groups(self):
        return ((0, 1), (2, 3)), ((0, 1), (2, 3))

    def condensed(self, log: Log) -> CondensedLog:
        R_s, R_r = self.machine.stator_resistance, self.machine.rotor_resistance
        v = -np.repeat([R_s, R_r], 2) * log.y
        v[:, : log.u.shape[1]] += log.u
        return CondensedLog(log.t, v, np.zeros((log.t.size, 0)), {})

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings, plant = self.observer, self.plant()
        if is_lifted(settings):
            stator, rotor = _relations(plant)
            return SideBySide(
                {"stator": lifted(stator, settings), "rotor": lifted(rotor, settings)}
            )

        def observer(winding, cutoff):
            return algebraic(
                plant.flux_relation(winding),
                cutoff,
                threshold=settings.threshold,
                completion=settings.completion,
                start=settings.start,
                gain=rates.get("gain"),
            )

        stator = observer("stator", rates["cutoff"])
        rotor = observer("rotor", rates["rotor_cutoff"])
        return SideBySide({"stator": stator, "rotor": rotor})

    def columns(self, estimate: Any, log: Log) -> Columns:
        stator, rotor = estimate["stator"], estimate["rotor"]
        fluxes = in_columns(STATOR, stator.value) | in_columns(ROTOR, rotor.value)
        known = deviations_of(STATOR, stator) | deviations_of(ROTOR, rotor)
        return fluxes | certified(stator, "_s") | certified(rotor, "_r") | known

    def truth(self, log: Log) -> Columns:
        return log.truth

    def circles(self) -> tuple[Circle, ...]:
        machine, mutual = self.machine, self.machine.mutual_inductance
        alike: dict[str, Any] = {"radius_name": "mutual inductance", "radius_unit": "H"}
        stator = Circle(
            "stator flux",
            machine.stator_resistance,
            machine.stator_inductance,
            mutual,
            resistance_name="resistance of the stator",
            inductance_name="inductance of the stator",
            other=(2, 3),
            symbols=self.signals.inputs[:2] + self.signals.outputs[:2],
            **alike,
        )
        rotor = Circle(
            "rotor flux",
            machine.rotor_resistance,
            machine.rotor_inductance,
            mutual,
            resistance_name="resistance of the rotor",
            inductance_name="inductance of the rotor",
            inputs=(2, 3),
            outputs=(2, 3),
            other=(0, 1),
            symbols=self.signals.optional + self.signals.outputs[2:],
            **alike,
        )
        return stator, rotor

    def residuals(self, columns: Columns, log: Log) -> Columns:
        machine, found = self.machine, {}
        i_s, i_r = log.y[:, :2].T, log.y[:, 2:].T
        for name, names, L, own, other in (
            ("stator flux", STATOR, machine.stator_inductance, i_s, i_r),
            ("rotor flux", ROTOR, machine.rotor_inductance, i_r, i_s),
        ):
            flux = np.stack([columns[column] for column in names])
            linked = length(*(flux - L * own)) - machine.mutual_inductance * length(*other)
            found[name] = relative(linked, length(*flux))
        return found
