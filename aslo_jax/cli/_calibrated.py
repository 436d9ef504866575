"""What the command `calibrate` says of a calibration, and whether it may be written."""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._text import measured_unit
from ..logs import Log
from ..machines import AbstractDescription, MachineError
from ..machines._lifted import is_lifted
from ..tune import Calibration
from ..tune._calibration.adequacy import named
from ..tune._calibration.result import DOUBTFUL
from ..tune._calibration.whiten import Signals
from . import _table as table
from ._running import opened, tabulated, with_noise

WORSE = 1.2  # times the residual that the old parameters leave

FITS = {"output_offset": "offset"}
# By the field of an error that is fitted, the kinds of what a verdict calls it.
EXPLAINED = {
    "output_offset": ("offset",),
    "input_offset": ("offset",),
    "gain": ("voltage_scale",),
    "dead_time": ("dead_time",),
    "threshold": ("dead_time",),
    "encoder_offset": (),
    "delay": ("voltage_timing", "voltage_instant"),
}
# What a verdict says of a log whose parameters or known errors are wrong: the calibration
# has looked for these itself. Any other verdict goes before what a calibration finds.
OWN = {"resistance", "inductance", "radius", "inconsistent", "noise"}
OWN |= {kind for kinds in EXPLAINED.values() for kind in kinds}
# A thousand times: no parameter that one would start from looks like that.
UNITS = ("current_unit", "voltage_unit", "time_unit")
# Errors of a log that other parameters explain as well: with voltages or currents that are
# scaled, every motor's resistance, inductance and flux are.
SCALES = ("power_invariant", "voltage_scale", "current_scale")

Warned = list[dict[str, Any]]


def verdict(path: Path, machine: AbstractDescription, **reading: Any) -> Warned:
    """What `aslo-jax estimate` says of the log `path` with this `machine`; `reading` is
    what [`LogReader`][] takes."""
    reader, rates = opened(path, machine, {}, truth=False, **reading)
    filled, noise = with_noise(reader, machine)
    steps = 1 if is_lifted(machine.observer) else 4
    nothing = lambda rows: None
    done = tabulated(reader, filled, rates, steps, None, False, nothing, noise=noise)
    return done.warned()


def other_units(said: Sequence[Mapping[str, Any]]) -> str:
    """What a verdict has `said` of the units of a log, if anything."""
    return "; ".join(each["message"] for each in said if each["kind"] in UNITS)


def turned(refusal: str, said: Sequence[Mapping[str, Any]]) -> str:
    """The `refusal` of a log whose outputs seem to have the wrong sign, or what the verdict
    has `said` where that is another error: with it no sign fits, and the better one of two
    tells nothing."""
    others = [
        each["message"] for each in said if each["kind"] not in {*OWN, "sign"} - {*SCALES}
    ]
    return f"No calibration: {'; '.join(others)}." if others else refusal


def taken_up(
    first: Sequence[Mapping[str, Any]], said: Sequence[Mapping[str, Any]]
) -> Warned:
    """Scales of the log that the `first` verdict told of, and that of the new parameters,
    `said`, does not: these have taken them up."""
    still = {each["kind"] for each in said}
    return [
        {
            "kind": each["kind"],
            "message": "either the parameters are those found, or with those of the file "
            + each["message"],
            "rows": [],
        }
        for each in first
        if each["kind"] in SCALES and each["kind"] not in still
    ]


def warnings(
    found: Calibration, said: Sequence[Mapping[str, Any]], machine: AbstractDescription
) -> Warned:
    """The warnings about a calibration: `kind`, `message`, and `rows`, all of them, after
    what the verdict has `said`, but of the errors that were fitted."""
    fitted = {name.partition("[")[0] for name in of_record(machine, found)}
    known = {kind for name in fitted for kind in EXPLAINED[name]}
    told: Warned = [dict(each) for each in said if each["kind"] not in known]
    if found.withdrawn and any(each["kind"] not in OWN for each in said):
        return told  # the parameters were bent to a log that is another
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


def summary(found: Calibration, machine: AbstractDescription, out: Path) -> Iterator[str]:
    """What was found, in lines: what is in the file `out`, and what is not."""
    yield str(found)
    yield (
        f"{found.reason[0].upper()}{found.reason[1:]} after {found.rounds} rounds; noise "
        f"of the outputs {', '.join(f'{x:.2g}' for x in found.output_noise)}; correlation "
        f"of prediction errors {found.correlation:.2g}, near 0 where the model is right"
    )
    errors = of_record(machine, found)
    unknown = [n for n in found.after if not found.determined(n) and n not in errors]
    if unknown:
        yield f"unchanged in {out}: {', '.join(unknown)}"
    if unknown and not found.withdrawn:
        needed, _ = machine.telling
        yield f"what determines them: {needed}; --resolution takes wider intervals"
    wider = {name: found.allowed[name] for name in found.after if found.allowed[name]}
    if wider and not found.withdrawn:
        several = dict.fromkeys(field for fields in wider.values() for field in fields)
        yield (
            f"the intervals of {', '.join(wider)} allow for errors that this log does not "
            f"rule out, one at a time: {named(tuple(several))}; {machine.telling[1]} tells "
            "them from the parameters"
        )
    if errors:
        units = units_of(machine, found)
        values = [f"{n} {found.estimate[n]:.4g} {units[n]}".strip() for n in errors]
        yield (
            f"errors of the record, which {out} does not hold: {', '.join(values)}; "
            "correct the log by them, in Python by `found.imperfections`"
        )


def of_record(machine: AbstractDescription, found: Calibration) -> list[str]:
    """The names of what was fitted and is no parameter of the machine."""
    known = machine.constants()
    return [name for name in found.after if name.partition("[")[0] not in known]


def units_of(machine: AbstractDescription, found: Calibration) -> dict[str, str]:
    """The units of the parameters, and of the errors of the record, by name."""
    constants, of = machine.constant_units(), machine.signals
    outputs, inputs = (measured_unit((*names, "")[0]) for names in (of.outputs, of.inputs))
    known = {"output_offset": outputs, "input_offset": inputs, "dead_time": inputs}
    known |= {"threshold": outputs, "delay": "samples", "gain": "", "encoder_offset": "rad"}
    units = {}
    for name in found.estimate:
        key = name.partition("[")[0]
        if key in constants:
            units[name] = constants[key].replace("ohm", "Ω")
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
    parameters = {
        name: {
            "value": _number(found.estimate[name]),
            "half_width": _number(found.half_width(name)),
            "low": _number(found.interval[name][0]),
            "high": _number(found.interval[name][1]),
            "before": _number(found.before[name]),
            "determined": found.determined(name),
            "allowed": list(found.allowed[name]),
            "written": found.determined(name) and name.partition("[")[0] in values,
        }
        for name in found.estimate
    }
    content = {
        "parameters": parameters,
        "warnings": list(warned),
        "withdrawn": found.withdrawn or None,
        "confidence": found.confidence,
        "correlation": _number(found.correlation),
        "output_noise": [_number(x) for x in found.output_noise],
        "rounds": found.rounds,
        "reason": found.reason,
    }
    return json.dumps(content, indent=2) + "\n"


def nothing_as_json(
    machine: AbstractDescription,
    names: Sequence[str],
    why: str,
    warned: Sequence[Mapping[str, Any]],
) -> str:
    """That a log says nothing of the parameters `names`."""
    nothing = dict.fromkeys(("value", "half_width", "low", "high"))
    parameters: dict[str, Any] = {}
    for name in names:
        old = np.asarray(machine.constants()[name], float)
        for j, value in enumerate(old.ravel()):
            label = f"{name}[{j}]" if old.ndim else name
            parameters[label] = nothing | {
                "before": float(value),
                "determined": False,
                "allowed": [],
                "written": False,
            }
    content = {
        "parameters": parameters,
        "warnings": list(warned),
        "withdrawn": None,
        "reason": why,
    }
    return json.dumps(content, indent=2) + "\n"


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def check_calibrated(
    before: AbstractDescription,
    after: AbstractDescription,
    log: Log,
    found: Calibration,
) -> None:
    """Refuse parameters with which the observer does not run, or satisfies its relation
    less well than with the old ones, on a log without the errors that were found in it.

    **Raises:** [`MachineError`][]."""
    if of_record(before, found):
        signals = Signals(*map(jnp.asarray, (np.diff(log.t), log.u, log.y)))
        _, u, y = found.imperfections(signals)
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
