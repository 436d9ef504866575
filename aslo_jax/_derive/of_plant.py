"""A plant as a model, to derive its observer."""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx

from .._checks import is_concrete
from ..plants import AbstractModelledPlant
from .model import Model, Range

KEPT = 32  # derivations


def model_of(
    plant: AbstractModelledPlant, ranges: Mapping[str, Range] | None = None
) -> Model:
    """The equations of a plant as a model, its parameters those of the plant.

    - `plant`: with numbers for parameters;
    - `ranges`: by name, where a signal usually is, `(low, high)`, in the place of what the
      plant says, which suits its default parameters.

    **Raises:** `ValueError` for a plant that is being traced, and for a name that is none
    of its states, outputs and inputs.
    """
    numbers = _numbers(plant)
    kind, names = type(plant), list(numbers)
    groups = (plant.states, plant.outputs, plant.inputs)
    given = dict(ranges or {})
    known = [name for group in groups for name in group]
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ValueError(
            f"Argument `ranges` must be by the names {', '.join(known)}, but has "
            f"{', '.join(unknown)}."
        )

    def called(function: str) -> Any:
        def of(x: Any, y: Any, u: Any, p: Any) -> Any:
            leaves = lambda plant: [getattr(plant, name) for name in names]
            at = eqx.tree_at(leaves, plant, [p[name] for name in names])
            return getattr(at, function)(x[: len(plant.states)], y, u)

        base = getattr(AbstractModelledPlant, function)
        return None if getattr(kind, function) is base else of

    spans = [
        {name: given.get(name, (span.low, span.high)) for name, span in group.items()}
        for group in groups
    ]
    units = {name: span.unit for group in groups for name, span in group.items()}
    units |= {name: f.metadata["unit"] for name, f in plant.parameters().items()}
    return Model(
        called("f"),
        called("g"),
        called("h"),
        states=spans[0],
        outputs=spans[1],
        inputs=spans[2],
        parameters={name: float(value) for name, value in numbers.items()},
        unknown=plant.unknown,
        units=units,
    )


class _Values:
    """A plant by its values, to be a key."""

    def __init__(self, plant: AbstractModelledPlant) -> None:
        self.plant = plant
        self.key = type(plant), *(float(each) for each in _numbers(plant).values())

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Values) and self.key == other.key


def once(plant: AbstractModelledPlant, derive: Callable[[Model], Any]) -> Any:
    """What `derive` makes of a plant's equations, kept for the next one with the same
    values."""
    return _kept(_Values(plant), derive)


@functools.lru_cache(maxsize=KEPT)
def _kept(values: _Values, derive: Callable[[Model], Any]) -> Any:
    return derive(model_of(values.plant))


def _numbers(plant: AbstractModelledPlant) -> dict[str, Any]:
    """The parameters of a plant, which must not be traced."""
    found = {name: getattr(plant, name) for name in plant.parameters()}
    if not is_concrete(*found.values()):
        raise ValueError(
            "Argument `plant` must have numbers for parameters, but they are being traced; "
            "derive before, and give the relation other `parameters`."
        )
    return found
