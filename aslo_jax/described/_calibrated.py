"""The calibration of a described machine, and its file with the values that were found."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..logs import Log
from ..machines import AbstractDescription, MachineError
from ..schema import hint
from ..schema._toml_text import rewritten, rounded
from ..tune import Calibration, calibrate

FAR = 3.0  # times another value than in the file: what was found is no value of it


def calibrate_machine(
    machine: AbstractDescription[Any, Any],
    log: Log,
    parameters: Sequence[str] = (),
    **settings: Any,
) -> Calibration:
    """[`calibrate`][] for a described `machine`.

    - `log`: of the machine, in SI units;
    - `parameters`: keys of `[machine]`, by default all that its relation depends on;
    - `settings`: of [`calibrate`][], by default those of the file's `[calibration]`.

    The intervals are withdrawn where a parameter is more than three times larger or
    smaller than in the file: that is a log in other units, or of another machine.

    **Raises:** [`MachineError`][] for a kind that offers no parameters, and for a name that
    is not one of them.
    """
    names = parameters_of(machine, parameters)
    settings = machine.calibration.model_dump() | settings
    given = {k: settings[k] for k in ("cutoff",) if settings.get(k) is not None}
    found = calibrate(
        machine.fitted(log, given),
        log.t,
        log.u,
        log.y,
        where=lambda model: tuple(machine.leaf(model, name) for name in names),
        angle=log.angle,
        **settings,
    )
    return _near(found)


def parameters_of(
    machine: AbstractDescription[Any, Any], asked: Sequence[str] = ()
) -> tuple[str, ...]:
    """The keys of `[machine]` that a calibration finds: those that are `asked` for, or the
    usual ones.

    **Raises:** [`MachineError`][], as [`calibrate_machine`][].
    """
    kind, unknowns = machine.kind, machine.offered()
    if unknowns.refused or not unknowns.usual:
        raise MachineError(
            f'A machine of kind "{kind}" has no calibration: '
            f"{unknowns.refused or 'its description offers no parameters'}."
        )
    every = unknowns.usual
    known = (*every, *unknowns.further)
    for name in asked:
        if name not in known:
            near = hint(name, known, "; did you mean `{}`?") or "."
            raise MachineError(
                f"Argument `parameters` (option --parameter) must name one of "
                f'{", ".join(known)} for a machine of kind "{kind}", but got `{name}`{near}'
            )
    if asked:
        return tuple(asked)
    # What is zero in the file is taken to be absent, unless it is asked for.
    constants = machine.constants()
    return tuple(n for n in every if np.any(np.asarray(constants[n])))


def _near(found: Calibration) -> Calibration:
    """What was `found`, its intervals withdrawn where it is far from the file's values."""
    far = [
        name
        for name, old in found.before.items()
        if old and not 1.0 / FAR < found.estimate[name] / old < FAR
    ]
    if found.withdrawn or not any(found.determined(name) for name in far):
        return found
    nothing = dict.fromkeys(found.after, np.nan)
    return dataclasses.replace(
        found,
        after=nothing,
        interval=dict.fromkeys(found.interval, (np.nan, np.nan)),
        withdrawn=f"values of {' and '.join(far)} more than {FAR:g} times off those of the "
        "file, as a log in other units, or of another machine, does",
    )


def values_of(machine: AbstractDescription[Any, Any], found: Calibration) -> dict[str, Any]:
    """The constants of a machine, keys of its `[machine]`, that a calibration `found` to
    change, with their new values: numbers, or lists of them. A value that is not determined
    stays.
    """
    values: dict[str, Any] = {}
    constants = machine.constants()
    for name in found.after:
        key, _, entry = name.partition("[")
        if not np.isfinite(found.after[name]) or key not in constants:
            continue
        old = np.asarray(constants[key], float)
        new = np.array(values.get(key, old))
        if entry and new.ndim:
            new[int(entry.rstrip("]"))] = found.after[name]
        else:
            new = np.asarray(found.after[name])
        values[key] = rounded(new.tolist())
    return values


def calibrated_text(
    text: str, values: Mapping[str, Any], machine: AbstractDescription | None = None
) -> str:
    """A description, the `text` of its file, with new `values` of its constants; all else,
    comments too, as it was. `machine`: the description, by default one whose constants are
    keys of `[machine]`.

    **Raises:** [`MachineError`][] where a value is not on one line of its own.
    """
    try:
        tables = {"machine": values} if machine is None else machine.in_file(values)
        return rewritten(text, tables)
    except ValueError as error:
        raise MachineError(str(error)) from error
