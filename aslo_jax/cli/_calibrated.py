"""What the command `calibrate` says of a calibration, and whether it may be written."""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._text import measured_unit
from ..logs import Log
from ..machines import AbstractDescription, MachineError
from ..tune import Calibration
from ..tune._calibration.result import DOUBTFUL
from ..tune._calibration.whiten import Signals
from . import _table as table

WORSE = 1.2  # times the residual that the old parameters leave

FITS = {"output_offset": "offset"}


def warnings(found: Calibration) -> list[dict[str, Any]]:
    """The warnings about a calibration: `kind`, `message`, and `rows`, all of them."""
    told = []
    for k, finding in enumerate(found.findings):
        name = FITS.get(finding.field, finding.field)
        if k and finding.share < 0.5 * found.findings[0].share:
            continue
        trust = "the parameters cannot be trusted without it" if found.withdrawn else ""
        message = f"the log shows {finding}{'; ' if trust else ''}{trust}: --fit {name}"
        told.append({"kind": name, "message": message, "rows": []})
    if found.withdrawn and not found.findings:
        message = f"the log shows {found.withdrawn}; the parameters cannot be trusted"
        told.append({"kind": "model", "message": message, "rows": []})
    if abs(found.correlation) > DOUBTFUL and not found.withdrawn:
        message = (
            f"the prediction errors are correlated ({found.correlation:.2g}): the model, "
            "or its sampling, leaves more than noise does; the intervals allow for what "
            "varies along the log, and not for what is wrong throughout."
        )
        told.append({"kind": "correlation", "message": message, "rows": []})
    return told


def units_of(machine: AbstractDescription, found: Calibration) -> dict[str, str]:
    """The units of the parameters, and of the errors of the record, by name."""
    fields, of = type(machine.machine).model_fields, machine.signals
    outputs, inputs = (measured_unit((*names, "")[0]) for names in (of.outputs, of.inputs))
    known = {"output_offset": outputs, "input_offset": inputs, "dead_time": inputs}
    known |= {"delay": "samples", "gain": ""}
    units = {}
    for name in found.estimate:
        key = name.partition("[")[0]
        if key in fields:
            extra: Any = fields[key].json_schema_extra or {}
            units[name] = extra.get("unit", "").replace("ohm", "Ω")
        else:
            units[name] = known.get(key, "")
    return units


def electrical_frequency(
    machine: AbstractDescription, columns: Mapping[str, np.ndarray]
) -> tuple[float, float] | None:
    """The electrical frequencies (Hz) that hold in nine tenths of the rows of a table of
    estimates; `None` of a machine that has none, and where it does not turn."""
    for quantity in machine.quantities:
        if quantity.tracks is None:
            continue
        speed = np.abs(columns[quantity.columns[0]]) / (2 * np.pi)
        speed = speed[np.isfinite(speed) & (columns[f"coasting{quantity.suffix}"] == 0)]
        if speed.size and np.median(speed) > 0:
            low, high = np.percentile(speed, [5, 95])
            return float(low), float(high)
    return None


def as_json(
    found: Calibration, values: Mapping[str, Any], warned: Sequence[Mapping[str, Any]]
) -> str:
    """The whole of a calibration: SI units, null for what there is not."""

    def number(x: float) -> float | None:
        return float(x) if math.isfinite(x) else None

    parameters = {
        name: {
            "value": number(found.estimate[name]),
            "half_width": number(found.half_width(name)),
            "low": number(found.interval[name][0]),
            "high": number(found.interval[name][1]),
            "before": number(found.before[name]),
            "determined": found.determined(name),
            "written": found.determined(name) and name.partition("[")[0] in values,
        }
        for name in found.estimate
    }
    return json.dumps(
        {
            "parameters": parameters,
            "warnings": list(warned),
            "withdrawn": found.withdrawn or None,
            "confidence": found.confidence,
            "correlation": number(found.correlation),
            "output_noise": [number(x) for x in found.output_noise],
            "rounds": found.rounds,
            "reason": found.reason,
        },
        indent=2,
    )


def check_calibrated(
    before: AbstractDescription,
    after: AbstractDescription,
    log: Log,
    found: Calibration,
) -> None:
    """Refuse parameters with which the observer does not run, or satisfies its relation
    less well than with the old ones, on a log without the errors that were found in it.

    **Raises:** [`MachineError`][]."""
    _, u, y = found.imperfections(
        Signals(*map(jnp.asarray, (np.diff(log.t), log.u, log.y)))
    )
    log = dataclasses.replace(log, u=np.asarray(u), y=np.asarray(y))
    residuals = []
    for machine in (before, after):
        columns = table.estimate_log(log, machine, machine.rates(log))
        each = machine.residuals(columns, log)
        values = np.concatenate([np.ravel(x) for x in each.values()])
        values = values[np.isfinite(values)]
        residuals.append(float(np.median(values)) if values.size else math.nan)
    old, new = residuals
    if not math.isfinite(new) or new > WORSE * old:
        raise MachineError(
            "No calibration: with the parameters that were found the observer leaves a "
            f"residual of {new:.2g}, and {old:.2g} with those of the file; nothing is "
            "written. The log has an error that the model does not know: see what "
            "`aslo-jax estimate` says of it."
        )
