"""A spread: which parameters of an experiment vary in a study, and how."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._continuous import AnyExperiment
from .._typing import DesignName
from ._designs import DESIGNS, Design, make_design
from ._distributions import AbstractDistribution
from ._leaves import Changed, Layout, Place, Where, sample_keys, study_keys


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter that varies.

    - `where`: what it sets: a path such as `"plant.resistance"`, in which `*` stands for
      one or more names (`"observers.*.relation.resistance"`) and a last number for an entry
      of an array (`"initial.0"`); or a function of the experiment that returns leaves of
      it. Several are set to the same value, an array in all its entries. Of a distribution
      of several numbers it is a sequence, with an item for each of them;
    - `distribution`: of the value;
    - `relative`: whether the value multiplies what the experiment has, 1 for no change;
    - `names`: those of the numbers of a distribution of several, by default counted.
    """

    where: Where | Sequence[Where]
    distribution: AbstractDistribution
    relative: bool = False
    names: tuple[str, ...] | None = None


class Spread:
    """What varies in a study, `parameters` by name: each a [`Parameter`][], or
    `(where, distribution)`.

    - `design`: how the samples are laid out, `"iid"`, `"lhs"` (Latin hypercube, held in
      memory as a whole) or `"sobol"` (scrambled); the latter two of scipy.stats.qmc.

    Parameters of plant, controller and observers are leaves of their own: what is spread in
    the plant is what the observers do not know.

    **Raises:** `ValueError` for another `design`.
    """

    def __init__(
        self,
        parameters: Mapping[str, Parameter | tuple[Any, AbstractDistribution]],
        design: DesignName = "iid",
    ) -> None:
        if design not in DESIGNS:
            allowed = " or ".join(f'"{name}"' for name in DESIGNS)
            raise ValueError(f"Argument `design` must be {allowed}, but got {design!r}.")
        self.design: DesignName = design
        self.parameters: dict[str, Parameter] = {
            name: each if isinstance(each, Parameter) else Parameter(*each)
            for name, each in parameters.items()
        }

    def __repr__(self) -> str:
        return f"Spread({self.parameters!r}, design={self.design!r})"


def names_of(spread: Spread) -> list[str]:
    """The names of the numbers that a spread draws."""
    return [each for n, p in spread.parameters.items() for each in _names(n, p)]


class Sampler:
    """The samples of a spread on an experiment, by index: a sample depends on the seed and
    its index only, of a Latin hypercube also on the number of `samples`.

    - `make(sample)`: the experiment of one sample, for [`Runner`][];
    - `names`: of the numbers drawn.
    """

    def __init__(
        self, experiment: AnyExperiment, spread: Spread, seed: int, samples: int
    ) -> None:
        layout = Layout(experiment)
        self.names: list[str] = []
        places: list[tuple[Place, ...]] = []
        relative: list[bool] = []
        taken: dict[Place, str] = {}
        for name, parameter in spread.parameters.items():
            names = _names(name, parameter)
            for each, where in zip(names, _wheres(name, parameter), strict=True):
                try:
                    found = layout.places(where)
                except ValueError as error:
                    raise ValueError(f"`spread.{name}`: {error}") from None
                _refuse_overlap(layout, taken, found, each)
                places.append(found)
                relative.append(parameter.relative)
            self.names += names
        if len(set(self.names)) < len(self.names):
            raise ValueError(
                f"Argument `spread` must have different names, but got {self.names}."
            )
        self.parameters = tuple(spread.parameters.values())
        self.design: Design = make_design(spread.design, self.names, seed, samples)
        self.keys = study_keys(layout, seed)
        self.make = Changed(
            experiment, layout, tuple(places), tuple(relative), tuple(layout.random_keys())
        )

    def __getstate__(self) -> dict[str, Any]:
        """Sent to other processes, it draws and no more: whoever runs has `make`."""
        return {k: v for k, v in vars(self).items() if k != "make"}

    def values(self, start: int, stop: int) -> Float[np.ndarray, "N d"]:
        """The numbers drawn for the samples from `start` to before `stop`."""
        return self.quantiles(self.design(start, stop))

    def quantiles(self, u: Float[np.ndarray, "N d"]) -> Float[np.ndarray, "N d"]:
        """The numbers at points of the unit cube, one coordinate for each."""
        done, first = [], 0
        for parameter in self.parameters:
            last = first + parameter.distribution.dimension
            done.append(parameter.distribution.quantiles(u[:, first:last]))
            first = last
        return np.concatenate([*done, np.empty((len(u), 0))], axis=1)

    def like(self) -> dict[str, Any]:
        """The shapes and types of one sample."""
        shape = lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype)
        number = shape(jnp.zeros(()))
        return {
            "index": shape(jnp.asarray(0)),
            "values": [number] * len(self.names),
            "keys": [shape(key) for key in self.keys],
        }

    def __call__(self, index: np.ndarray, values: np.ndarray) -> dict[str, Any]:
        """The samples of these indices and numbers, for `make`."""
        columns = [jnp.asarray(values[:, k]) for k in range(values.shape[1])]
        keys = sample_keys(self.keys, index)
        return {"index": jnp.asarray(index), "values": columns, "keys": keys}


def _names(name: str, parameter: Parameter) -> list[str]:
    dimension = parameter.distribution.dimension
    if parameter.names is not None:
        if len(parameter.names) != dimension:
            raise ValueError(
                f"Argument `names` of `{name}` must hold {dimension} names, but got "
                f"{list(parameter.names)}."
            )
        return list(parameter.names)
    return [name] if dimension == 1 else [f"{name}_{k}" for k in range(dimension)]


def _wheres(name: str, parameter: Parameter) -> list[Where]:
    where, dimension = parameter.where, parameter.distribution.dimension
    items = [where] if isinstance(where, str) or callable(where) else list(where)
    if len(items) != dimension:
        raise ValueError(
            f"Argument `where` of `{name}` must have an item for each of the {dimension} "
            f"numbers of {type(parameter.distribution).__name__}, but has {len(items)}."
        )
    return items


def _refuse_overlap(
    layout: Layout, taken: dict[Place, str], places: tuple[Place, ...], name: str
) -> None:
    for place in places:
        for other, owner in taken.items():
            shorter = min(len(place.entry), len(other.entry))
            same = place.leaf == other.leaf
            if same and place.entry[:shorter] == other.entry[:shorter]:
                raise ValueError(
                    f"Argument `spread` must set every leaf once, but `{owner}` and "
                    f"`{name}` both set `{layout.paths[place.leaf]}`."
                )
    taken.update(dict.fromkeys(places, name))
