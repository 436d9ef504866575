"""The calibration of a described machine, and its file with the values that were found."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .. import _toml_text
from ..logs import Log
from ..tune import Calibration, calibrate
from .base import AbstractDescription, MachineError

# What the relation of a kind depends on, and is not simply known.
PARAMETERS: dict[str, tuple[str, ...]] = {
    "pmsm": ("resistance", "inductance", "magnet_flux"),
    "stepper": ("resistance", "inductance", "torque_constant"),
    "wrim": (
        "stator_resistance",
        "rotor_resistance",
        "stator_inductance",
        "rotor_inductance",
        "mutual_inductance",
    ),
    "magnetic_bearing": ("resistance", "gap"),
    "robotic_leg": ("m1", "m2", "damping"),
    "ball_beam": ("length", "damping"),
}
REFUSED = {
    "interior_pmsm": "its relation holds only up to the ripple of the d current",
    "mechanical": "its parameters are in Python; use `aslo_jax.tune.calibrate` there",
}


def calibrate_machine(
    machine: AbstractDescription,
    log: Log,
    parameters: Sequence[str] = (),
    **settings: Any,
) -> Calibration:
    """[`calibrate`][] for a described machine.

    - `parameters`: keys of `[machine]`, by default all that its relation depends on;
    - `settings`: of [`calibrate`][].
    """
    kind = machine.kind
    if kind in REFUSED:
        raise MachineError(
            f'A machine of kind "{kind}" has no calibration: {REFUSED[kind]}.'
        )
    every = PARAMETERS[kind]
    known = [*every, "force_constant"] if kind == "magnetic_bearing" else every
    known = [*known, "gravity"] if kind == "ball_beam" else known
    for name in parameters:
        if name not in known:
            raise MachineError(
                f"Argument `parameters` (option --parameter) must name one of "
                f'{", ".join(known)} for a machine of kind "{kind}", but got `{name}`.'
            )
    names = tuple(parameters) or every
    if not parameters:
        # What is zero in the file is taken to be absent, unless it is asked for.
        names = tuple(n for n in names if np.any(np.asarray(getattr(machine.machine, n))))
    return calibrate(
        machine.plant(),
        log.t,
        log.u,
        log.y,
        where=lambda plant: tuple(getattr(plant, name) for name in names),
        **settings,
    )


def values_of(machine: AbstractDescription, found: Calibration) -> dict[str, Any]:
    """The keys of `[machine]` that a calibration changes, with their new values: numbers,
    or lists of them. A value that is not determined stays."""
    values: dict[str, Any] = {}
    for name in found.after:
        key, _, entry = name.partition("[")
        if not np.isfinite(found.after[name]) or not hasattr(machine.machine, key):
            continue
        old = np.asarray(getattr(machine.machine, key), float)
        new = np.array(values.get(key, old))
        if entry and new.ndim:
            new[int(entry.rstrip("]"))] = found.after[name]
        else:
            new = np.asarray(found.after[name])
        # Seven digits are more than any record determines.
        values[key] = np.vectorize(lambda x: float(f"{x:.7g}"))(new).tolist()
    return values


def rewritten(text: str, values: Mapping[str, Any]) -> str:
    """A description with new `values` in `[machine]`; all else, comments too, as it was.

    **Raises:** [`MachineError`][] where a value is not on one line of its own."""
    try:
        return _toml_text.rewritten(text, {"machine": values})
    except ValueError as error:
        raise MachineError(str(error)) from error
