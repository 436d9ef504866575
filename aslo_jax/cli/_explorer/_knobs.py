"""Knobs: what of a source can be moved, between which limits."""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ...machines import studies
from ...machines._registry import KINDS
from ...schema._table import unit_of
from ...study._config.observers import Observer
from ._state import StateError

SPAN = 100.0  # of a gain: times more and less than in the file
ERRORS = 0.3  # of a parameter, relative
STARTS = ("exact", "paper")
LOOP = "loop.pll_bandwidth"


@dataclasses.dataclass(frozen=True)
class Knob:
    """What can be moved.

    - `key`: its name in an address; `label`, `unit`, `group`: as the page has them;
    - `low`, `high`: its limits; `default`: a number, or a word of `options`;
    - `scale`: `"log"`, `"zero-log"`, with zero at the lower end, `"linear"`, or `"choice"`.
    """

    key: str
    label: str
    group: str
    default: float | str
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    scale: str = "linear"
    options: tuple[str, ...] = ()

    def checked(self, value: float | str) -> float | str:
        """The `value` of this knob.

        **Raises:** [`StateError`][] for one that it cannot have.
        """
        if self.options:
            if value not in self.options:
                words = ", ".join(self.options)
                raise StateError(f"`{self.key}` must be one of {words}, but is {value!r}.")
            return value
        if isinstance(value, str):
            raise StateError(f"`{self.key}` must be a number, but is {value!r}.")
        low = 0.0 if self.scale == "zero-log" else self.low
        if not low <= value <= self.high:
            raise StateError(
                f"`{self.key}` must be from {low:g} to {self.high:g} {self.unit}".rstrip()
                + f", but is {value:g}."
            )
        return value

    def described(self) -> dict[str, Any]:
        """The same for the page."""
        return dataclasses.asdict(self)


def settings(
    knobs: Iterable[Knob], values: Mapping[str, float | str]
) -> dict[str, float | str]:
    """The value of every knob: the `values` that are given, and defaults.

    **Raises:** [`StateError`][] for a key that is no knob, or a value that it cannot have.
    """
    known = {knob.key: knob for knob in knobs}
    for key in values:
        if key not in known:
            raise StateError(f"There is no knob `{key[:80]}` here.")
    return {
        key: knob.checked(values[key]) if key in values else knob.default
        for key, knob in known.items()
    }


# By kind of machine: key of the content, label, unit, low, high.
_SPEED = "control.reference.offset"
CONDITIONS: dict[str, tuple[tuple[str, str, str, float, float], ...]] = {
    "pmsm": (
        (_SPEED, "speed, mean", "rad/s", -80.0, 80.0),
        ("control.reference.amplitude", "speed, swing", "rad/s", 0.0, 40.0),
        ("control.reference.frequency", "swing, frequency", "rad/s", 0.0, 40.0),
        ("machine.load.offset", "load torque", "N m", -2.0, 2.0),
    ),
    "wrim": (
        ("control.signal.amplitude", "supply, amplitude", "V", 1.0, 60.0),
        ("control.signal.frequency", "supply, frequency", "rad/s", 1.0, 100.0),
        ("control.signal.depth", "modulation, depth", "", 0.0, 0.8),
        ("control.signal.rate", "modulation, frequency", "rad/s", 0.0, 20.0),
        ("machine.load.offset", "load torque", "N m", 0.0, 10.0),
    ),
    "robotic_leg": (
        ("control.reference.amplitude.0", "length, swing", "m", 0.0, 0.5),
        ("control.reference.amplitude.1", "angle, swing", "rad", 0.0, 1.5),
        ("control.bandwidth", "tracking, bandwidth", "rad/s", 0.5, 20.0),
    ),
    "ball_beam": (
        ("control.reference.amplitude", "ball, swing", "m", 0.0, 0.5),
        ("control.reference.frequency", "swing, frequency", "rad/s", 0.0, 2.0),
    ),
    "magnetic_bearing": (
        ("control.reference.amplitude", "position, swing", "m", 0.0, 2e-4),
        ("control.reference.frequency", "swing, frequency", "rad/s", 0.0, 200.0),
        ("control.ripple", "voltage ripple", "V", 0.0, 30.0),
        ("machine.force.amplitude", "outer force, swing", "N", 0.0, 15.0),
    ),
    "double_integrator": (),
}
# By kind: unit, largest noise and offset of an output, of an input; largest dead time (V).
SIGNALS: dict[str, tuple[tuple[str, float, float], tuple[str, float, float], float]] = {
    "pmsm": (("A", 0.3, 0.3), ("V", 3.0, 3.0), 10.0),
    "wrim": (("A", 0.5, 0.5), ("V", 2.0, 2.0), 0.0),
    "robotic_leg": (("m, rad", 1e-2, 0.05), ("N, N m", 5.0, 5.0), 0.0),
    "ball_beam": (("m, rad", 1e-2, 0.05), ("N m/kg", 1.0, 1.0), 0.0),
    "magnetic_bearing": (("A", 0.05, 0.05), ("V", 1.0, 1.0), 0.0),
}
# By kind: key of `machine.initial`, of which entries, label, unit, half of the range.
STARTING: dict[str, tuple[tuple[str, str, str, float], ...]] = {
    "pmsm": (
        ("speed", "speed", "rad/s", 80.0),
        ("angle", "rotor angle", "rad", math.pi / 5),
    ),
    "wrim": (
        ("speed", "speed", "rad/s", 80.0),
        ("angle", "rotor angle", "rad", math.pi),
    ),
    "robotic_leg": (
        ("position.0", "length", "m", 0.8),
        ("position.1", "angle of the leg", "rad", 1.5),
        ("velocity.1", "rate of the leg", "rad/s", 3.0),
    ),
    "ball_beam": (
        ("position.0", "position of the ball", "m", 0.5),
        ("position.1", "angle of the beam", "rad", 0.6),
        ("velocity.1", "rate of the beam", "rad/s", 2.0),
    ),
    "magnetic_bearing": (("position", "position", "m", 2e-4),),
}


def of_content(content: Mapping[str, Any], observers: Iterable[str]) -> list[Knob]:
    """The knobs of a study's `content`, with the gains of these of its `observers`."""
    kind = content["machine"]["kind"]
    found = [k for name in observers for k in gains(name, content["observers"][name])]
    if kind == "pmsm":
        found.append(loop(0.5 / content["interval"]))
    found += _starts(kind, content["machine"].get("initial") or {})
    for key, label, unit, low, high in CONDITIONS.get(kind, ()):
        value = at(content, key)
        if value is not None:
            low, high = min(low, value), max(high, value)
            found.append(Knob(key, label, "Run", float(value), unit, low, high))
    found += _signals(content, kind)
    return [*found, *_errors(content["machine"], kind)]


def gains(name: str, table: Mapping[str, Any]) -> Iterator[Knob]:
    """The gains of an observer, and how its filters start."""
    fields = _fields(table["kind"])
    group, key = f"Gains of {name}", f"observers.{name}.".__add__
    if "start" in fields and "cutoff" in fields:
        start = table.get("start", "exact")
        yield Knob(key("start"), "start", group, start, scale="choice", options=STARTS)
    for each, value in table.items():
        if isinstance(value, int | float) and not isinstance(value, bool | int):
            unit = unit_of(fields[each]) if each in fields else ""
            label = each.replace("_", " ")
            limits = value / SPAN, value * SPAN
            if each == "threshold":
                limits = value / SPAN, min(value * SPAN, 0.99)
            yield Knob(key(each), label, group, float(value), unit, *limits, scale="log")


def loop(fastest: float, default: float = 100.0) -> Knob:
    """The bandwidth (rad/s) of the phase-locked loop of a motor."""
    label = "bandwidth of the loop"
    low, high = min(5.0, fastest), fastest
    start = min(default, fastest)
    return Knob(LOOP, label, "Speed", start, "rad/s", low, high, scale="log")


def _fields(kind: str) -> Mapping[str, Any]:
    """The keys of an observer's table."""
    tables = Observer.__origin__.__args__  # pyright: ignore[reportAttributeAccessIssue]
    for table in tables:
        if table.model_fields["kind"].annotation.__args__ == (kind,):
            return table.model_fields
    return {}


def _starts(kind: str, initial: Mapping[str, Any]) -> Iterator[Knob]:
    for name, label, unit, half in STARTING.get(kind, ()):
        value = at(initial, name)
        if value is not None:
            low, high = min(-half, value), max(half, value)
            if kind == "robotic_leg" and name == "position.0":
                low = min(0.3, value)
            key = f"machine.initial.{name}"
            yield Knob(key, label, "Start", float(value), unit, low, high)


def _signals(content: Mapping[str, Any], kind: str) -> Iterator[Knob]:
    if kind not in SIGNALS or kind not in KINDS:
        return
    of = KINDS[kind].layout.signals
    pairs = (("sensor", of.outputs), ("input_sensor", of.inputs))
    for (place, columns), (unit, noise, offset) in zip(
        pairs, SIGNALS[kind][:2], strict=True
    ):
        what = "outputs" if place == "sensor" else "inputs"
        deviation = noise_of(content, place)
        high = max(noise, deviation)
        limits: dict[str, Any] = {"low": high * 1e-4, "high": high, "scale": "zero-log"}
        yield Knob(f"noise.{place}", f"of the {what}", "Noise", deviation, unit, **limits)
        for k, column in enumerate(columns):
            yield Knob(f"offset.{place}.{k}", column, "Offsets", 0.0, unit, -offset, offset)
    if SIGNALS[kind][2]:
        most, label = SIGNALS[kind][2], "dead time of the inverter"
        yield Knob("dead_time.voltage", label, "Inverter", 0.0, "V", 0.0, most)


def noise_of(content: Mapping[str, Any], place: str) -> float:
    """The deviation of the white noise of a signal, zero where it has none, or several."""
    for table in content.get(place, ()):
        if table["kind"] == "noise" and not isinstance(table["deviation"], list):
            return float(table["deviation"])
    return 0.0


def _errors(machine: Mapping[str, Any], kind: str) -> Iterator[Knob]:
    """Of every parameter that may not be what the observers take it for."""
    study = studies()[kind]
    for key in study.machine.model_fields:
        value = machine.get(key)
        if isinstance(value, int) or key in ("kind", "inertia") or not _nonzero(value):
            continue
        label = key.replace("_", " ")
        yield Knob(f"error.{key}", label, "Parameter errors", 0.0, "1", -ERRORS, ERRORS)


def _nonzero(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(isinstance(x, float) and x for x in value)
    return isinstance(value, float) and value != 0.0


def at(content: Any, key: str) -> Any:
    """The number at a key such as `control.reference.amplitude.0`, `None` where there is
    none."""
    for name in key.split("."):
        if isinstance(content, Mapping):
            content = content.get(name)
        elif isinstance(content, list | tuple) and name.isdigit():
            content = content[int(name)] if int(name) < len(content) else None
        else:
            return None
    number = isinstance(content, int | float) and not isinstance(content, bool)
    return content if number else None
