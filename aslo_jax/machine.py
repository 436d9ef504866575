"""Machine descriptions: a validated TOML file to a motor and its flux observer.

[machine]
kind = "pmsm"
resistance = 8.875      # ohm
inductance = 40.03e-3   # H
magnet_flux = 0.2086    # Wb
pole_pairs = 5
inertia = 60e-6         # kg m^2

[observer]              # every key is optional
cutoff = 150.0          # rad/s
"""

import difflib
import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from ._extras import missing
from .completions import LeastSquares, Repeat
from .filters import LowPass
from .guard import Guard
from .observers import AbstractObserver, AlgebraicObserver, Asymptotic
from .plants import PMSM

try:
    from pydantic import BaseModel, ConfigDict, Field, ValidationError
except ModuleNotFoundError as error:
    raise missing("pydantic", "cli") from error

MINIMUM_CUTOFF = 5.0  # rad/s, what a log of a motor at rest gets

Positive = Annotated[float, Field(gt=0)]


class MachineError(ValueError):
    """A machine description that cannot be used: names file, key and allowed values."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class MachineTable(_Table):
    """`[machine]`: the motor, in SI units."""

    kind: Literal["pmsm"] = Field(description="the kind of machine")
    resistance: Positive = Field(description="stator resistance (ohm)")
    inductance: Positive = Field(description="stator inductance (H)")
    magnet_flux: Positive = Field(description="magnet flux, amplitude (Wb)")
    pole_pairs: Annotated[int, Field(gt=0)] = Field(description="number of pole pairs")
    inertia: Positive = Field(description="inertia of the rotor (kg m^2)")


class ObserverTable(_Table):
    """`[observer]`: its settings, all optional."""

    cutoff: Positive | None = Field(
        default=None, description="cutoff of the filter (rad/s); by default from the log"
    )
    completion: Literal["least-squares", "repeat"] = Field(
        default="least-squares", description="from one row to two"
    )
    start: Literal["exact", "paper"] = Field(
        default="exact", description="how the filters start"
    )
    gain: Positive | None = Field(
        default=None, description="gain of an A-ASLO (rad/s); by default none"
    )
    threshold: Positive = Field(
        default=1e-3, description="certificate below which the estimate coasts"
    )
    pll_bandwidth: Positive = Field(
        default=100.0, description="bandwidth of the phase-locked loop (rad/s)"
    )


class Machine(_Table):
    """A machine description, as [`read_machine`][] reads it.

    The default `threshold` suits signals with errors of about 3 % or less, which includes
    the discretisation of a log: the first instants after the start have certificates from
    1e-7 to 1e-3 and errors above 1 %.
    """

    machine: MachineTable
    observer: ObserverTable = ObserverTable()

    def motor(self) -> PMSM:
        """The motor described by `[machine]`."""
        return PMSM(**self.machine.model_dump(exclude={"kind"}))

    def flux_observer(self, cutoff: float | None = None) -> AbstractObserver:
        """The observer of the stator flux (Wb), from voltage (V) and current (A).

        - `cutoff` (rad/s): takes the place of the one in `[observer]`, which may be
          missing; [`cutoff_for`][] chooses one for a log.
        """
        settings = self.observer
        cutoff = settings.cutoff if cutoff is None else cutoff
        if cutoff is None:
            raise MachineError(
                "Argument `cutoff` must be given where `[observer]` has none, but got "
                "None; `cutoff_for` chooses one for a log."
            )
        observer = AlgebraicObserver(
            self.motor().flux_relation(),
            LowPass(cutoff),
            completion=LeastSquares()
            if settings.completion == "least-squares"
            else Repeat(),
            guard=Guard(threshold=settings.threshold),
            start=settings.start,
        )
        return observer if settings.gain is None else Asymptotic(observer, settings.gain)


def electrical_speed(
    t: Float[np.ndarray, " N"],
    u: Float[np.ndarray, "N 2"],
    y: Float[np.ndarray, "N 2"],
    resistance: float,
) -> float:
    """The typical electrical speed of a log (rad/s), unsigned, without an observer.

    It is the rate at which `u - R i` (V), the derivative of the flux, turns, averaged with
    its square as the weight; zero for a motor at rest. Against noise, samples are averaged
    over blocks in which it turns by about half a radian, and signed turns are summed over
    64 blocks before their size is taken.
    """
    v, size, speed = u - resistance * y, 1, 0.0
    for _ in range(8):  # noise makes the first speeds too large, the first blocks too short
        blocks = t.size // size
        means = v[: blocks * size].reshape(blocks, size, 2).mean(axis=1)
        times = t[: blocks * size].reshape(blocks, size).mean(axis=1)
        speed = _turning(times, means)
        wider = 0.5 * size / max(speed * float(np.median(np.diff(times))), 1e-9)
        previous, size = size, int(np.clip(wider, size, max(t.size // 8, 1)))
        if size == previous:
            break
    return speed


def _turning(t: Float[np.ndarray, " M"], v: Float[np.ndarray, "M 2"]) -> float:
    turn = v[:-1, 0] * v[1:, 1] - v[:-1, 1] * v[1:, 0]
    square = 0.5 * np.sum(v[:-1] ** 2 + v[1:] ** 2, axis=1)
    turned = np.abs(np.add.reduceat(turn, np.arange(0, turn.size, 64))).sum()
    weight = np.sum(square * np.diff(t))
    return float(turned / weight) if weight > 0 else 0.0


def cutoff_for(speed: float) -> float:
    """A cutoff (rad/s) for a typical electrical `speed` (rad/s): `speed / sqrt(3)`, where
    the paper's determinant is largest, and at least 5 rad/s (theory, section 9)."""
    return max(speed / math.sqrt(3.0), MINIMUM_CUTOFF)


def read_machine(path: Path | str) -> Machine:
    """Read and check the TOML file `path`.

    **Raises:** [`MachineError`][] for text that is not TOML, and for a key that is missing,
    unknown or out of range; `OSError` where the file cannot be opened.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        raise MachineError(f"{path} is a directory, but a machine is a TOML file.")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise MachineError(f"{path} is not valid TOML: {error}") from error
    try:
        return Machine.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(_explain(fault) for fault in error.errors())
        raise MachineError(f"{path}: {faults}.") from None


def _explain(fault: Any) -> str:
    """One fault that pydantic found, as a clause: key path, what is allowed, what is."""
    *tables, key = fault["loc"]
    path = ".".join(map(str, fault["loc"]))
    model: Any = Machine
    for table in tables:
        model = model.model_fields[table].annotation
    if fault["type"] == "extra_forbidden":
        close = difflib.get_close_matches(str(key), model.model_fields, n=1)
        hint = f"did you mean `{close[0]}`? " if close else ""
        return f"unknown key `{path}` ({hint}allowed: {', '.join(model.model_fields)})"
    field = model.model_fields[key]
    if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
        keys = ", ".join(field.annotation.model_fields)
        state = "is missing" if fault["type"] == "missing" else "must be a table"
        return f"the table `[{path}]` {state}; its keys: {keys}"
    if fault["type"] == "literal_error":
        allowed = " or ".join(f'"{choice}"' for choice in get_args(field.annotation))
    elif field.annotation is int:
        allowed = "a positive whole number"
    elif fault["type"] == "missing" and key == "kind":
        allowed = '"pmsm"'
    elif fault["type"].startswith("string"):
        allowed = "a text"
    else:
        allowed = "a positive finite number"
    what = f"`{path}`, {field.description},"
    if fault["type"] == "missing":
        return f"{what} is missing: it must be {allowed}"
    return f"{what} must be {allowed}, but is {fault['input']!r}"
