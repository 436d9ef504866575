"""What a study needs to know of a kind of machine: its keys, plant, observers, controls."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..observers import AbstractObserver
from ..plants import AbstractPlant
from ..schema import Table

Build = Callable[[Any, Any, Any], AbstractObserver]


def first_state(plant: AbstractPlant, table: Any) -> Any:
    """The plant's first state with what the table's `initial` gives in its place, `None`
    where that gives nothing.

    **Raises:** `ValueError` for a value of another shape than the state has.
    """
    given = {k: v for k, v in table.initial.model_dump().items() if v is not None}
    if not given:
        return None
    state = plant.initial()
    for name, value in given.items():
        old = getattr(state, name)
        new = jnp.asarray(value, float)
        if new.shape not in ((), old.shape):
            raise ValueError(
                f"`machine.initial.{name}` must hold {old.size} numbers, but is {value!r}"
            )
        new = jnp.broadcast_to(new, old.shape)
        state = eqx.tree_at(lambda s, n=name: getattr(s, n), state, new)
    return state


@dataclasses.dataclass(frozen=True)
class Range:
    """A number of a study's file that is moved by hand: its `key` there, such as
    `"control.reference.amplitude.0"`, in words (`label`), in `unit`, from `low` to `high`.
    """

    key: str
    label: str
    unit: str
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Errors:
    """What may be added to a signal, at most, in its `unit`: white `noise` of this standard
    deviation, and an `offset`."""

    unit: str
    noise: float
    offset: float


@dataclasses.dataclass(frozen=True)
class Explored:
    """How an experiment of a kind is moved by hand, by `aslo-jax explore`.

    - `run`: what it does; `start`: the state in which it starts;
    - `outputs`, `inputs`: what may be wrong with them;
    - `dead_time` (V): the largest of its inverter, zero where it has none;
    - `initial`: the state in which it starts where a file does not say, by key;
    - `usual`: where the ready-made study is begun differently, by key of the file;
    - `magnet`: whether the flux of a magnet makes it start without current.
    """

    run: tuple[Range, ...]
    start: tuple[Range, ...]
    outputs: Errors
    inputs: Errors
    dead_time: float = 0.0
    initial: Mapping[str, float] = dataclasses.field(default_factory=dict)
    usual: Mapping[str, float] = dataclasses.field(default_factory=dict)
    magnet: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """How a kind of machine takes part in studies.

    - `machine`: its keys in `[machine]`, `kind` among them; `acting`: those that a study
      adds to them, such as what acts on the machine and the state that it starts in;
    - `entries`: the names of what is estimated, and `units` of each;
    - `plant(table)`: the plant of a table with the keys of both;
    - `observers`: those that suit it, by their kind in `[observers.NAME]`, each with how it
      is made, `build(keys, plant, start)`: of the keys of its table and of the nominal
      plant, which starts in the state `start`;
    - `controls`: the kinds of `[control]` that suit it;
    - `metrics`: the kinds of `[metrics.NAME]` that suit it, beside those for any machine;
    - `bound`: whether its Cramer-Rao bound can be had;
    - `start(plant, table)`: the first state, `None` for the plant's own;
    - `leaf_units`: the units of what may be spread, by path, beside keys of the machine;
    - `of(table)`: of the machine of one file, where `entries`, `units` and `observers`
      depend on that; the names in `observers` are then those of every one.
    - `explored`: how it is moved by hand, `None` where it is not.
    """

    machine: type[Table]
    acting: type[Table]
    entries: tuple[str, ...]
    units: tuple[str, ...]
    plant: Callable[[Any], AbstractPlant]
    observers: Mapping[str, Build]
    controls: tuple[str, ...]
    metrics: tuple[str, ...] = ()
    bound: bool = False
    start: Callable[[AbstractPlant, Any], Any] = first_state
    leaf_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    of: "Callable[[Any], Study] | None" = None
    explored: Explored | None = None

    def of_file(self, table: Any) -> "Study":
        """The study of the machine of a file."""
        return self if self.of is None else self.of(table)

    @property
    def kind(self) -> str:
        """Its name in `machine.kind`."""
        (name,) = self.machine.model_fields["kind"].annotation.__args__  # pyright: ignore
        return name
