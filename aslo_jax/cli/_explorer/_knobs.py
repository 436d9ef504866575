"""Knobs: what of a source can be moved, between which limits."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ...machines import studies
from ...machines._registry import KINDS
from ...machines._study import Explored, Range
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


def of_content(content: Mapping[str, Any], observers: Iterable[str]) -> list[Knob]:
    """The knobs of a study's `content`, with the gains of these of its `observers`."""
    kind = content["machine"]["kind"]
    explored = studies()[kind].explored
    assert explored is not None, "a scene is of a kind that is explored"
    found = [k for name in observers for k in gains(name, content["observers"][name])]
    if "pll_bandwidth" in observer_fields(kind):
        found.append(loop(0.5 / content["interval"]))
    for group, ranges in (("Start", explored.start), ("Run", explored.run)):
        found += (knob for each in ranges for knob in _ranged(content, each, group))
    found += _signals(content, kind, explored)
    return [*found, *_errors(content["machine"], kind)]


def _ranged(content: Mapping[str, Any], about: Range, group: str) -> Iterator[Knob]:
    value = at(content, about.key)
    if value is not None:
        low, high = min(about.low, value), max(about.high, value)
        yield Knob(about.key, about.label, group, float(value), about.unit, low, high)


def observer_fields(kind: str) -> Mapping[str, Any]:
    """The keys of `[observer]` of a machine's description."""
    table: Any = KINDS[kind].model_fields["observer"].annotation
    return table.model_fields


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


def _signals(content: Mapping[str, Any], kind: str, explored: Explored) -> Iterator[Knob]:
    of = KINDS[kind].layout.signals
    for place, columns, what, about in (
        ("sensor", of.outputs, "outputs", explored.outputs),
        ("input_sensor", of.inputs, "inputs", explored.inputs),
    ):
        deviation, unit = noise_of(content, place), about.unit
        high = max(about.noise, deviation or 0.0)
        limits: dict[str, Any] = {"low": high * 1e-4, "high": high, "scale": "zero-log"}
        key, label = f"noise.{place}", f"of the {what}"
        if deviation is not None:
            yield Knob(key, label, "Noise", deviation, unit, **limits)
        for k, column in enumerate(columns):
            key, most = f"offset.{place}.{k}", about.offset
            yield Knob(key, column, "Offsets", 0.0, unit, -most, most)
    if explored.dead_time:
        most, label = explored.dead_time, "dead time of the inverter"
        yield Knob("dead_time.voltage", label, "Inverter", 0.0, "V", 0.0, most)


def noise_of(content: Mapping[str, Any], place: str) -> float | None:
    """The deviation of the white noise of a signal; nothing where it has another for each
    entry."""
    for table in content.get(place, ()):
        if table["kind"] == "noise" and not isinstance(table["deviation"], list):
            return float(table["deviation"])
    return None


def _errors(machine: Mapping[str, Any], kind: str) -> Iterator[Knob]:
    """Of every parameter that may not be what the observers take it for."""
    study = studies()[kind]
    for key in study.machine.model_fields:
        value = machine.get(key)
        if isinstance(value, int) or key in ("kind", "inertia") or not nonzero(value):
            continue
        label = key.replace("_", " ")
        yield Knob(f"error.{key}", label, "Parameter errors", 0.0, "1", -ERRORS, ERRORS)


def nonzero(value: Any) -> bool:
    """Whether it is a real number, or some of several, and not zero."""
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
