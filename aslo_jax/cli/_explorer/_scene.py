"""A simulated source: the content of a study, moved by knobs."""

import copy
import dataclasses
import functools
import math
import tomllib
from collections.abc import Mapping
from typing import Any

from ..._studies import ready_made
from ...study import Spread
from ...study._config import ConfigurationError, configure
from . import _knobs as knobs
from ._knobs import Knob
from ._state import State, StateError

# What can be chosen, by name, and the name that a person reads.
READY = {
    "pmsm": "PMSM under speed control",
    "wrim": "Wound-rotor induction machine",
    "magnetic_bearing": "Magnetic bearing",
    "robotic_leg": "Extensible leg",
    "ball_beam": "Ball on a beam",
}
PRINTED = "{}, printed start"
STEPS = (500, 1000, 2000, 5000, 10_000)  # of a run, to choose from
USUAL = 2000
FEWEST, LONGEST = 50, 20_000
SHOWN = 2  # observers at first
DEAD_TIME = {"kind": "dead_time", "voltage": 0.0, "threshold": 0.05}


@dataclasses.dataclass(frozen=True)
class Scene:
    """A source that is simulated.

    - `title`: what it is; `content`: that of its study, every key of it that is moved
      there; `observers`: the names of those that are shown at first.
    """

    title: str
    content: Mapping[str, Any]
    observers: tuple[str, ...]

    @functools.cached_property
    def tolerances(self) -> Spread:
        """What of its spread is relative, and so about any value."""
        parameters = configure(self.content).spread.parameters
        return Spread({n: p for n, p in parameters.items() if p.relative})

    @property
    def kind(self) -> str:
        """That of its machine."""
        return self.content["machine"]["kind"]

    def horizons(self) -> list[float]:
        """What can be chosen (s)."""
        return [round(n * self.content["interval"], 12) for n in STEPS]

    def chosen(self, state: State) -> tuple[str, ...]:
        """The observers of a `state`.

        **Raises:** [`StateError`][] for one that is not there.
        """
        known = tuple(self.content["observers"])
        for name in state.observers:
            if name not in known:
                raise StateError(
                    f"`observer` must be one of {', '.join(known)}, but is {name[:60]!r}."
                )
        return tuple(n for n in known if n in (state.observers or self.observers))

    def knobs(self, state: State) -> list[Knob]:
        """Those of the observers of a `state`."""
        return knobs.of_content(self.content, self.chosen(state))

    def steps(self, state: State) -> int:
        """How many intervals a run has.

        **Raises:** [`StateError`][] for a horizon that is too long, or too short.
        """
        interval = self.content["interval"]
        if state.horizon is None:
            return USUAL
        steps = round(state.horizon / interval)
        if not FEWEST <= steps <= LONGEST:
            raise StateError(
                f"`horizon` must be from {FEWEST * interval:g} to {LONGEST * interval:g} "
                f"s, but is {state.horizon:g}."
            )
        return steps

    def moved(self, state: State) -> "Moved":
        """The content in a `state`.

        **Raises:** [`StateError`][].
        """
        names = self.chosen(state)
        values = knobs.settings(self.knobs(state), state.values)
        new = copy.deepcopy(dict(self.content))
        new["observers"] = {name: new["observers"][name] for name in names}
        new["horizon"] = self.steps(state) * new["interval"]
        new["every"] = None
        errors: dict[str, float] = {}
        for key, value in values.items():
            group, _, rest = key.partition(".")
            if group == "error":
                errors[rest] = float(value)
            elif group == "noise":
                _set_noise(new[rest], float(value))
            elif group == "offset":
                place, _, k = rest.partition(".")
                new[place][-1]["offset"][int(k)] = float(value)
            elif group == "dead_time":
                new["actuator"][-1]["voltage"] = float(value)
            elif key != knobs.LOOP:
                _set(new, key, value)
        _magnet_at(new["machine"], errors)
        return Moved(new, errors, self.steps(state))


@dataclasses.dataclass(frozen=True)
class Moved:
    """The `content` of a study in a state, the relative `errors` of the plant's parameters,
    and the number of `steps`."""

    content: dict[str, Any]
    errors: dict[str, float]
    steps: int


@functools.lru_cache(maxsize=8)
def ready(name: str) -> Scene:
    """The ready-made scene of that name.

    **Raises:** [`StateError`][].
    """
    if name not in READY:
        raise StateError(f"`source` must be one of {', '.join(READY)}, but is {name!r}.")
    return scene_of(tomllib.loads(ready_made(name)), READY[name])


def scene_of(content: Mapping[str, Any], title: str | None = None) -> Scene:
    """The scene of a study's `content`, checked as a whole.

    **Raises:** [`ConfigurationError`][] for a content that is not right, or of a kind of
    machine that has no logs.
    """
    new = copy.deepcopy(dict(content))
    kind = new["machine"]["kind"]
    if kind not in READY:
        raise ConfigurationError(
            f"`machine.kind` must be one of {', '.join(READY)} to be explored, but is "
            f'"{kind}".'
        )
    observers = dict(new["observers"])
    first = tuple(observers)[:SHOWN]
    for name, table in list(observers.items()):
        takes_start = table["kind"] == "aslo" and kind != "magnetic_bearing"
        if takes_start and table.get("start", "exact") == "exact":
            other = PRINTED.format(name)
            observers.setdefault(other, dict(table) | {"start": "paper"})
            if title is not None and name == first[0]:
                first = (name, other)
    new["observers"] = observers
    of = knobs.KINDS[kind].layout.signals
    pairs = (("sensor", of.outputs), ("input_sensor", of.inputs))
    for place, columns in pairs:
        _in_a_chain(new, place)
        parts = [dict(part) for part in new.get(place, ())]
        if not any(part["kind"] == "noise" for part in parts):
            parts.append({"kind": "noise", "deviation": 0.0})
        new[place] = [*parts, {"kind": "bias", "offset": [0.0] * len(columns)}]
    if knobs.SIGNALS[kind][2]:
        _in_a_chain(new, "actuator")
        new["actuator"] = [*map(dict, new.get("actuator", ())), dict(DEAD_TIME)]
    _complete(new, ready_made=title is not None)
    if title is None:  # those that are ready made are right
        title = configure(new).title
    return Scene(title, new, first)


def _in_a_chain(content: dict[str, Any], place: str) -> None:
    """What varies in the one disturbance of a place, once others stand beside it."""
    if len(content.get(place, ())) != 1:
        return
    alone, first = f"{place}.", f"{place}.parts.0."
    renamed = lambda w: first + w.removeprefix(alone) if w.startswith(alone) else w
    for item in content.get("spread", {}).values():
        where = item["where"]
        several = isinstance(where, list)
        item["where"] = [renamed(w) for w in where] if several else renamed(where)


def _complete(content: dict[str, Any], *, ready_made: bool) -> None:
    """Say what a file leaves to defaults, and knobs move. A ready-made motor turns from the
    start, without a load that would stall it: at standstill nothing shows its flux."""
    machine = content["machine"]
    initial = {k: v for k, v in (machine.get("initial") or {}).items() if v is not None}
    if machine["kind"] in ("pmsm", "wrim"):
        speed = knobs.at(content, "control.reference.offset") if ready_made else None
        initial = {"speed": speed or 0.0, "angle": 0.0} | initial
        load = dict(machine.get("load") or {})
        free = ready_made and machine["kind"] == "pmsm"
        machine["load"] = load | {"offset": 0.0} if free else {"offset": 0.0} | load
    if machine["kind"] == "magnetic_bearing":
        initial = {"position": 0.0} | initial
    machine["initial"] = initial
    _magnet_at(machine, {})


def _magnet_at(machine: dict[str, Any], errors: Mapping[str, float]) -> None:
    """A motor with a magnet starts without current, whatever its angle."""
    if machine["kind"] == "pmsm":
        turned = machine["pole_pairs"] * machine["initial"]["angle"]
        flux = machine["magnet_flux"] * (1.0 + errors.get("magnet_flux", 0.0))
        machine["initial"]["flux"] = [flux * math.cos(turned), flux * math.sin(turned)]


def _set_noise(parts: list[dict[str, Any]], deviation: float) -> None:
    for part in parts:
        if part["kind"] == "noise" and not isinstance(part["deviation"], list):
            part["deviation"] = deviation
            return


def _set(content: Any, key: str, value: float | str) -> None:
    """Put a value where a key such as `observers.A, B.cutoff` leads."""
    group, _, rest = key.partition(".")
    if group == "observers":  # whose names hold anything but dots
        name, _, last = rest.rpartition(".")
        content["observers"][name][last] = value
        return
    *names, last = key.split(".")
    for name in names:
        content = content[int(name) if isinstance(content, list) else name]
    content[int(last) if isinstance(content, list) else last] = value
