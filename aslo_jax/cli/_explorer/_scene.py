"""A simulated source: the content of a study, moved by knobs."""

import copy
import dataclasses
import functools
import math
import tomllib
from collections.abc import Mapping
from typing import Any

from ..._studies import NAMES, ready_made
from ...machines import KINDS, studies
from ...machines._study import Explored
from ...study import Spread
from ...study._config import ConfigurationError, configure
from . import _knobs as knobs
from ._knobs import Knob
from ._state import State, StateError

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
      there; `observers`: the names of those that are shown at first;
    - `idle`: whether a motor with a magnet starts without current, its flux that of the
      magnet, where the study does not say otherwise.
    """

    title: str
    content: Mapping[str, Any]
    observers: tuple[str, ...]
    idle: bool

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
        found = knobs.of_content(self.content, self.chosen(state))
        if self.idle or not explored_of(self.kind).magnet:
            return found
        return [knob for knob in found if knob.key != "machine.initial.angle"]

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
        if self.idle:
            _magnet_at(new["machine"], errors)
        return Moved(new, errors, self.steps(state))


@dataclasses.dataclass(frozen=True)
class Moved:
    """The `content` of a study in a state, the relative `errors` of the plant's parameters,
    and the number of `steps`."""

    content: dict[str, Any]
    errors: dict[str, float]
    steps: int


def explored_of(kind: str) -> Explored:
    """How experiments of a kind of machine are moved by hand.

    **Raises:** [`ConfigurationError`][] for a kind that is not."""
    offered = {n: each.explored for n, each in studies().items()}
    found = offered.get(kind)
    if found is None:
        names = ", ".join(n for n, each in offered.items() if each is not None)
        raise ConfigurationError(
            f'`machine.kind` must be one of {names} to be explored, but is "{kind}".'
        )
    return found


def names() -> list[str]:
    """Those of the scenes that are ready made, each that of its kind of machine."""
    return [n for n in NAMES if n in studies() and studies()[n].explored is not None]


@functools.lru_cache(maxsize=8)
def ready(name: str) -> Scene:
    """The ready-made scene of that name.

    **Raises:** [`StateError`][].
    """
    if name not in names():
        raise StateError(f"`source` must be one of {', '.join(names())}, but is {name!r}.")
    return scene_of(tomllib.loads(ready_made(name)), KINDS[name].title)


def scene_of(content: Mapping[str, Any], title: str | None = None) -> Scene:
    """The scene of a study's `content`, checked as a whole unless it is ready made and has
    a `title`.

    **Raises:** [`ConfigurationError`][] for a content that is not right, in continuous
    time, or of a kind of machine that is not explored.
    """
    new = copy.deepcopy(dict(content))
    if new.get("time") == "continuous":
        raise ConfigurationError(
            '`time` must be "sampled" to be explored, but is "continuous".'
        )
    kind = new["machine"]["kind"]
    explored, takes_start = explored_of(kind), "start" in knobs.observer_fields(kind)
    observers = dict(new["observers"])
    first = tuple(observers)[:SHOWN]
    for name, table in list(observers.items()):
        exact = table["kind"] == "aslo" and table.get("start", "exact") == "exact"
        if takes_start and exact:
            other = PRINTED.format(name)
            observers.setdefault(other, dict(table) | {"start": "paper"})
            if title is not None and name == first[0]:
                first = (name, other)
    new["observers"] = observers
    of = KINDS[kind].layout.signals
    for place, columns in (("sensor", of.outputs), ("input_sensor", of.inputs)):
        _in_a_chain(new, place)
        parts = [dict(part) for part in new.get(place, ())]
        if not any(part["kind"] == "noise" for part in parts):
            parts.append({"kind": "noise", "deviation": 0.0})
        new[place] = [*parts, {"kind": "bias", "offset": [0.0] * len(columns)}]
    if explored.dead_time:
        _in_a_chain(new, "actuator")
        new["actuator"] = [*map(dict, new.get("actuator", ())), dict(DEAD_TIME)]
    idle = explored.magnet and not (new["machine"].get("initial") or {}).get("flux")
    _complete(new, explored)
    if title is not None:  # what is ready made is right
        for key, value in explored.usual.items():
            _set(new, key, value)
    if idle:
        _magnet_at(new["machine"], {})
    return Scene(configure(new).title if title is None else title, new, first, idle)


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


def _complete(content: dict[str, Any], explored: Explored) -> None:
    """Say what a file leaves to defaults, and knobs move."""
    machine = content["machine"]
    given = {k: v for k, v in (machine.get("initial") or {}).items() if v is not None}
    machine["initial"] = dict(explored.initial) | given
    for each in explored.run:
        table, *names, last = each.key.split(".")
        if table == "machine" and knobs.at(content, each.key) is None:
            inner = machine
            for name in names:
                inner[name] = dict(inner.get(name) or {})
                inner = inner[name]
            inner[last] = 0.0


def _magnet_at(machine: dict[str, Any], errors: Mapping[str, float]) -> None:
    """A motor with a magnet starts without current, whatever its angle."""
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
