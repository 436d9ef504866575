"""Machines that cannot be, by the checks of their descriptions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...machines import known_kind
from ._state import StateError


def refuse_impossible(
    machine: Mapping[str, Any],
    errors: Mapping[str, float],
    draws: Sequence[tuple[str, np.ndarray]] = (),
    tolerance: float = 0.0,
) -> None:
    """Refuse a machine that cannot be, such as windings that share more than all of their
    flux.

    - `machine`: its parameters; `errors` of them, relative;
    - `draws`: by path, the factors of many machines, shape `(runs,)`, times `tolerance`.

    **Raises:** [`StateError`][] that says how many cannot be, and why.
    """
    table: Any = known_kind(machine["kind"]).model_fields["machine"].annotation
    known = {k: v for k, v in machine.items() if k in table.model_fields}
    of = {w.removeprefix("plant."): v for w, v in draws if w.startswith("plant.")}
    of = {key: values for key, values in of.items() if key in known}
    runs = len(next(iter(of.values()))) if of else 1
    impossible, said = 0, ""
    for k in range(runs):
        true = dict(known)
        for key in {*errors, *of}:
            factor = 1.0 + errors.get(key, 0.0)
            if key in of:
                factor *= 1.0 + tolerance * (float(of[key][k]) - 1.0)
            true[key] = times(known[key], factor)
        try:
            table.model_validate(true)
        except ValidationError as error:
            impossible, said = impossible + 1, error.errors()[0]["msg"]
    if impossible:
        which = f"{impossible} of {runs} machines" if draws else "This machine"
        raise StateError(f"{which} cannot be: {said.removeprefix('Value error, ')}.")


def times(value: Any, factor: float) -> Any:
    """A number, or each of several, times a factor."""
    return [factor * x for x in value] if isinstance(value, list) else factor * value
