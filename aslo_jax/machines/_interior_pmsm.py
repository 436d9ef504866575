"""`kind = "interior_pmsm"`: the interior permanent-magnet synchronous motor."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import model_validator

from .._completions import LeastSquares, Repeat
from .._filters import LowPass
from .._guard import Guard
from ..diagnosis import Circle
from ..logs import Log
from ..observers import AbstractObserver, SelfConsistent
from ..plants import InteriorPMSM, SalientFluxRelation
from ..schema import Positive, Table, Whole, key
from . import _keys as keys, _lifted, motor
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    MachineError,
    Rate,
    Rates,
    Unknowns,
    algebraic,
)
from ._condensed import CondensedLog
from ._lifted import LIFTED, ObserverTable, is_lifted, lifted


class InteriorPMSMTable(Table):
    """`[machine]` of an interior PMSM, in SI units."""

    kind: Literal["interior_pmsm"] = key("the kind of machine", example="interior_pmsm")
    resistance: Positive = key("stator resistance", "ohm", example=3.6)
    direct_inductance: Positive = key("inductance Ld of the d axis", "H", example=36e-3)
    quadrature_inductance: Positive = key("inductance Lq of the q axis", "H", example=51e-3)
    magnet_flux: Positive | None = key(
        'magnet flux, amplitude; not needed with `observer.saliency = "neglected"`',
        "Wb",
        default=None,
        example=0.545,
    )
    pole_pairs: Whole = key("number of pole pairs", example=3)
    inertia: Positive = key("inertia of the rotor", "kg m^2", example=0.015)


class InteriorPMSMObserver(ObserverTable):
    """`[observer]` of an interior PMSM, all optional.

    - `saliency = "self-consistent"` takes the d current from the observer's own estimate
      and has no error in the end; it comes from that of `"neglected"` at the rate `gain`,
      without a proof that it always arrives (see [`SelfConsistent`][]).
    - `saliency = "neglected"` drops `m (Ld - Lq) i_d` from the relation. It needs no magnet
      flux, and is exact while i_d is constant; a ripple of i_d leaves an error of up to
      half of that ripple times |Ld - Lq|.
    """

    saliency: Literal["self-consistent", "neglected"] = key(
        "what becomes of the d current", default="self-consistent"
    )
    cutoff: Positive | None = keys.cutoff()
    completion: keys.Completion = keys.completion()
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain('the cutoff, with saliency = "neglected" none')
    threshold: Positive = keys.threshold()
    pll_bandwidth: Positive | None = keys.pll_bandwidth()
    kind: _lifted.ObserverKind = _lifted.kind_key()
    output_deviation: _lifted.Deviation | None = _lifted.deviation_key("currents", 0.01)
    input_deviation: _lifted.Deviation | None = _lifted.deviation_key("voltages", 0.1)
    prior: Positive | None = _lifted.prior_key(0.5)


class InteriorPMSMDescription(AbstractDescription[InteriorPMSMTable, InteriorPMSMObserver]):
    """An interior PMSM: flux, angle and speed from stator voltages and currents. The angle
    is that of the active flux, `flux - Lq i`.

    **Raises:** `ValueError` where the default saliency has no magnet flux, or the start
    `"paper"`; [`MachineError`][] for a plant without a magnet flux.
    """

    machine: InteriorPMSMTable
    observer: InteriorPMSMObserver = InteriorPMSMObserver()

    kind = "interior_pmsm"
    title: ClassVar[str] = "Interior PMSM"
    layout: ClassVar[Layout] = motor.LAYOUT
    motion = "does the motor turn?"
    residual: ClassVar[str] = "| |flux - Lq i| - m - (Ld - Lq) i_d | / magnet flux"
    refused: ClassVar[Mapping[str, str]] = {}
    longest_interval: ClassVar[float] = motor.LONGEST_INTERVAL
    unknowns: ClassVar[Unknowns] = Unknowns(
        refused="its relation holds only up to the ripple of the d current"
    )

    @model_validator(mode="after")
    def _agree(self):
        if self.observer.saliency == "neglected":
            return self
        if is_lifted(self.observer):
            raise ValueError(
                f'`observer.kind = "{LIFTED}"` needs `observer.saliency = "neglected"`, '
                'but it is "self-consistent" (the default), whose relation depends on '
                "the estimate; set it"
            )
        if self.machine.magnet_flux is None:
            raise ValueError(
                "`machine.magnet_flux`, magnet flux, amplitude (Wb), is missing, which "
                '`observer.saliency = "self-consistent"` (the default) needs: give it, or '
                'set `observer.saliency = "neglected"`'
            )
        if self.observer.start == "paper":
            raise ValueError(
                '`observer.start`, how the filters start, must be "exact" with '
                "`observer.saliency = \"self-consistent\"` (the default), but is 'paper'; "
                'remove it, or set `observer.saliency = "neglected"`'
            )
        return self

    def plant(self) -> Any:
        if self.machine.magnet_flux is None:
            raise MachineError(
                "`machine.magnet_flux` must be given for a plant, but is missing; the "
                "observer does without it."
            )
        return InteriorPMSM(**self.machine.model_dump(exclude={"kind"}))

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        rates = motor.motor_rates(log, stated)
        cutoff = rates["cutoff"].constant if "cutoff" in rates else stated.get("cutoff")
        needed = self.observer.saliency == "self-consistent" and "gain" not in stated
        if needed and cutoff is not None:
            rates["gain"] = Rate(cutoff, "that of the filter")
        return rates

    def condensed(self, log: Log) -> CondensedLog:
        return motor.driving(log, self.machine.resistance)

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings = self.observer
        if is_lifted(settings):
            return lifted(self._salient(), settings)
        cutoff = rates["cutoff"].constant
        if settings.saliency == "self-consistent":
            least_squares = settings.completion == "least-squares"
            return SelfConsistent(
                self.plant().self_consistent_relation(),
                LowPass(cutoff),
                rates["gain"].constant,
                initial=jnp.zeros(2),
                completion=LeastSquares() if least_squares else Repeat(),
                guard=Guard(threshold=settings.threshold),
                forget=True,
            )
        return algebraic(
            self._salient(),
            rates["cutoff"],
            threshold=settings.threshold,
            completion=settings.completion,
            start=settings.start,
            gain=rates.get("gain"),
        )

    def _salient(self) -> SalientFluxRelation:
        return SalientFluxRelation(
            self.machine.resistance,
            self.machine.direct_inductance,
            self.machine.quadrature_inductance,
        )

    def columns(self, estimate: Any, log: Log) -> Columns:
        inductance = self.machine.quadrature_inductance
        active = np.asarray(estimate.value) - inductance * log.y
        return motor.motor_columns(estimate, active, inductance, self.observer)

    def followed(self) -> motor.MagnetAngle:
        return motor.MagnetAngle(self.machine.quadrature_inductance)

    def truth(self, log: Log) -> Columns:
        return motor.motor_truth(log, self.machine.pole_pairs)

    def circles(self) -> tuple[Circle, ...]:
        machine = self.machine
        circle = Circle(
            "flux",
            machine.resistance,
            machine.quadrature_inductance,
            machine.magnet_flux,
            inductance_name="inductance of the q axis",
            saliency=machine.direct_inductance - machine.quadrature_inductance,
        )
        return (circle,)

    def residuals(self, columns: Columns, log: Log) -> Columns:
        if self.machine.magnet_flux is None:
            return {}
        machine, m = self.machine, self.machine.magnet_flux
        active = motor.flux_of(columns) - machine.quadrature_inductance * log.y
        size = np.linalg.norm(active, axis=1)
        direct = np.sum(active * log.y, axis=1) / np.maximum(size, np.finfo(float).tiny)
        saliency = machine.direct_inductance - machine.quadrature_inductance
        return {"flux": np.abs(size - m - saliency * direct) / m}
