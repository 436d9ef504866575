"""Parameters of a plant that an observer does not know, as states of the bound."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._continuous import ContinuousExperiment
from .._module import Module
from .._typing import PyTree
from ..plants import AbstractPlant


class Unknown(Module):
    """Leaves of a plant by `names`, fields joined by dots, and the `deviations` of their
    relative errors, each one number or shaped like the leaf."""

    names: tuple[str, ...] = eqx.field(static=True)
    deviations: tuple[Float[Array, "..."], ...]

    @property
    def size(self) -> int:
        """The number of entries of all leaves."""
        return sum(d.size for d in self.deviations)

    def values(self, plant: AbstractPlant) -> list[Float[Array, "..."]]:
        """The leaves, in their units."""
        return [jnp.asarray(_leaf(plant, name)) for name in self.names]

    def start(self, plant: AbstractPlant) -> Float[Array, " q"]:
        """The deviations of the relative errors, one for each entry of each leaf."""
        each = [
            jnp.broadcast_to(jnp.asarray(d, float), v.shape).ravel()
            for d, v in zip(self.deviations, self.values(plant), strict=True)
        ]
        return jnp.concatenate([jnp.zeros(0), *each])

    def at(self, plant: AbstractPlant, errors: Float[Array, " q"]) -> AbstractPlant:
        """The plant whose leaves have these relative errors."""
        values, first = [], 0
        for v in self.values(plant):
            part = errors[first : first + v.size].reshape(v.shape)
            values.append(v * (1.0 + part))
            first += v.size
        if not values:
            return plant
        leaves = lambda plant: [_leaf(plant, name) for name in self.names]
        return eqx.tree_at(leaves, plant, values)

    def split(self, variance: np.ndarray) -> dict[str, np.ndarray]:
        """Entries on the last axis by the name of their leaf, where each is a number, and
        else by name and number of the entry."""
        sizes = [max(1, np.size(d)) for d in self.deviations]
        parts = np.split(variance, np.cumsum(sizes)[:-1], axis=-1)
        return {
            name: part if np.ndim(d) else part[..., 0]
            for name, d, part in zip(self.names, self.deviations, parts, strict=True)
        }


def unknown_of(
    given: Mapping[str, Any] | None, make: Callable[[PyTree], Any], samples: PyTree
) -> Unknown:
    """Those that are `given`, with deviations shaped like their leaves; checked against the
    plants of all samples, whose experiments must have samples in time."""
    first = jax.tree.map(lambda x: x[0], samples)
    if isinstance(eqx.filter_eval_shape(make, first), ContinuousExperiment):
        raise ValueError(
            "Argument `make` must give an `Experiment`, but gives a "
            "`ContinuousExperiment`: the bound is one of samples in time."
        )
    given = dict(given or {})
    found = Unknown(tuple(given), tuple(jnp.asarray(d, float) for d in given.values()))
    if not given:
        return found
    plant = lambda sample: make(sample).plant
    one = eqx.filter_eval_shape(plant, first)
    deviations = []
    for name, deviation in zip(found.names, found.deviations, strict=True):
        leaf = _leaf(one, name)
        shape = getattr(leaf, "shape", None)
        if shape is None or not jnp.issubdtype(leaf.dtype, jnp.floating):
            raise ValueError(
                "Argument `unknown` must name real parameters of the plant, but `"
                f"{name}` is none of {type(one).__name__}."
            )
        if deviation.ndim and deviation.shape != shape:
            raise ValueError(
                f"Argument `unknown` must have one number for `{name}`, or one for each "
                f"entry, of shape {shape}, but got the shape {deviation.shape}."
            )
        if not bool(jnp.all(jnp.isfinite(deviation) & (deviation >= 0))):
            raise ValueError(
                "Argument `unknown` must have relative deviations that are zero or "
                f"positive, but `{name}` has {np.asarray(deviation).tolist()}."
            )
        deviations.append(jnp.broadcast_to(deviation, shape))
    found = Unknown(found.names, tuple(deviations))
    values = eqx.filter_jit(jax.vmap(lambda s: found.values(plant(s))))(samples)
    for name, value in zip(found.names, values, strict=True):
        if not bool(jnp.all(value != 0)):
            raise ValueError(
                "Argument `unknown` must name parameters that are not zero, since "
                f"deviations are relative, but `{name}` is in some sample."
            )
    return found


def _leaf(plant: Any, name: str) -> Any:
    leaf = plant
    for part in name.split("."):
        if isinstance(leaf, Mapping):
            leaf = leaf.get(part)
        elif isinstance(leaf, tuple | list):
            fits = part.isdigit() and int(part) < len(leaf)
            leaf = leaf[int(part)] if fits else None
        else:
            leaf = getattr(leaf, part, None)
    return leaf
