"""What a log tells of a study's file: its machine, its noise, its speed and load."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._replay import replay
from ..logs import Log
from ..machines import AbstractDescription, machine_of
from ..schema._toml_text import rounded
from ..tune import Calibration
from ..tune._calibration.result import SETTLED
from ._calibrated import calibrate_machine, values_of
from ._tuned import changed

# Of what is spread, which follows the speed or the load of a log.
OPERATED = {"controller.reference.offset": "speed", "plant.load.offset": "load"}


def calibrate_study(
    content: Mapping[str, Any], log: Log, *, folder: Path = Path(), **settings: Any
) -> tuple[Calibration, dict[str, dict[str, Any]]]:
    """Calibrate the machine of a study's file from a log without ground truth.

    - `content`: of the file, table by table, which lies in `folder`; `log`: of the machine;
    - `settings`: of [`calibrate_machine`][].

    Returns the calibration, and new values by table and key: those of `machine` that the
    log determines; the `deviation` of the file's first noise on the sensor (`sensor.0`,
    say), which the calibration has found in the log; and of a motor under speed control its
    speed and load, and what the file spreads of them, moved there.

    **Raises:** [`MachineError`][] for a kind of machine that has no logs or no calibration.
    """
    description = machine_of(content, folder)
    found = calibrate_machine(description, log, **settings)
    if found.withdrawn or found.reason != SETTLED:
        return found, {}
    values = description.in_file(values_of(description, found))
    for k, disturbance in enumerate(content.get("sensor", ())):
        if disturbance["kind"] == "noise":
            noise = np.asarray(found.output_noise)
            whole = not isinstance(disturbance["deviation"], list)
            level = np.sqrt(np.mean(noise**2)) if whole else noise
            values[f"sensor.{k}"] = {"deviation": rounded(np.asarray(level).tolist())}
            break
    if content["control"]["kind"] == "field_oriented":
        run = operation_in(machine_of(changed(content, values), folder), log)
        for table, items in _operated(content, run).items():
            values[table] = values.get(table, {}) | items
    return found, values


def operation_in(machine: AbstractDescription, log: Log) -> dict[str, float]:
    """How a `machine` was run in a `log`: see [`AbstractDescription.operation`][]."""
    observer = machine.state_observer(machine.rates(log))
    estimate = replay(observer, log.t, log.u, log.y, substeps=4, engine="auto")
    return machine.operation(machine.columns(estimate, log), log)


def _operated(
    content: Mapping[str, Any], run: Mapping[str, float]
) -> dict[str, dict[str, Any]]:
    """The new values of a file for the speed and the load of a log."""
    if not run:
        return {}
    machine, reference = content["machine"], content["control"]["reference"]
    load = run["torque"] - machine.get("friction", 0.0) * run["speed"]
    values: dict[str, dict[str, Any]] = {
        "control.reference": {"offset": rounded(run["speed"])}
    }
    if reference.get("amplitude"):
        values["control.reference"]["amplitude"] = rounded(run["swing"])
    if "load" in machine:
        values["machine.load"] = {"offset": rounded(load)}
    else:
        values["machine"] = {"load": {"offset": rounded(load)}}
    for name, item in content.get("spread", {}).items():
        where = item["where"]
        if item.get("relative") or where not in OPERATED:
            continue
        new = {"speed": run["speed"], "load": load}[OPERATED[where]]
        table = reference if OPERATED[where] == "speed" else machine.get("load", {})
        moved = _moved(item, table.get("offset", 0.0), new)
        if moved:
            values[f"spread.{name}"] = moved
    return values


def _moved(item: Mapping[str, Any], old: float, new: float) -> dict[str, Any]:
    """A distribution about `old` as one about `new`: as wide as it was, or of a logarithm
    that is as wide."""
    if item["distribution"] == "log-normal":
        scale = new / old if old and new / old > 0 else new / item["median"]
        return {"median": rounded(item["median"] * scale)} if scale > 0 else {}
    if item["distribution"] not in ("normal", "uniform"):
        return {}
    places = [k for k in ("mean", "low", "high") if k in item]
    return {k: rounded(item[k] + new - old) for k in places}
