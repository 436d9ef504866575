"""What ran over time, as named columns: for figures and for tables."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float


class Track(NamedTuple):
    """One observer over `N` instants: its `value`, in its own units, `certificate` (1) and
    whether it is `coasting`."""

    value: Float[np.ndarray, "N n"]
    certificate: Float[np.ndarray, " N"]
    coasting: Bool[np.ndarray, " N"]


def tracks(found: Any) -> dict[str, Track]:
    """Every estimate in an [`Estimate`][], a mapping of them or a [`Simulation`][] by the
    name of its observer, which is empty where there is one without a name."""
    if hasattr(found, "estimates"):
        found = found.estimates
    if isinstance(found, Mapping):
        return {
            ".".join(filter(None, (name, inner))): track
            for name, each in found.items()
            for inner, track in tracks(each).items()
        }
    if not all(hasattr(found, name) for name in Track._fields):
        raise ValueError(
            "Argument `found` must be an `Estimate`, as `replay` returns it, a mapping of "
            f"them or a `Simulation`, but is of the type {type(found).__name__}."
        )
    value, certificate, coasting = (np.asarray(getattr(found, n)) for n in Track._fields)
    if value.ndim != 2 or {certificate.shape, coasting.shape} != {value.shape[:1]}:
        raise ValueError(
            "Argument `found` must be one estimate over time, `value` of shape (N, n) and "
            f"`certificate` of shape (N,), but their shapes are {value.shape} and "
            f"{certificate.shape}; of a batch take one at a time, "
            "`jax.tree.map(lambda x: x[0], estimate)`."
        )
    return {
        "": Track(value.astype(float), certificate.astype(float), coasting.astype(bool))
    }


def instants(t: Any, rows: int) -> Float[np.ndarray, " N"]:
    """`t` (s), of which there must be `rows`."""
    if t is None:
        raise ValueError(
            "Argument `t` must be given for an estimate, which does not know its instants: "
            "pass the `t` that `replay` had."
        )
    found = np.asarray(t, float)
    if found.shape != (rows,):
        raise ValueError(
            f"Argument `t` must have the shape ({rows},), one instant for each row of the "
            f"estimate, but has {found.shape}; pass the `t` that `replay` had."
        )
    return found


def names_of(names: Sequence[str] | None, count: int, stem: str) -> list[str]:
    """The `names` of so many entries, by default the `stem` with their numbers."""
    if names is None:
        return [f"{stem}_{k}" for k in range(count)]
    found = [names] if isinstance(names, str) else list(names)
    if len(found) != count or len(set(found)) != count:
        raise ValueError(
            f"Argument `names` must hold {count} different names, one for each entry of "
            f"the estimate, but is {found}."
        )
    return found


def leaves(stem: str, tree: Any) -> dict[str, np.ndarray]:
    """The leaves of a tree with a leading axis of time as columns: `u`, or `u_0`, `u_1`,
    and `u.name_0` of a mapping."""
    found = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        name = ".".join([stem, *(_key(entry) for entry in path)])
        x = np.asarray(leaf)
        for index in np.ndindex(x.shape[1:]):
            found["_".join([name, *map(str, index)])] = x[(slice(None), *index)]
    return found


def _key(entry: Any) -> str:
    for kind in ("key", "name", "idx"):
        if hasattr(entry, kind):
            return str(getattr(entry, kind))
    return str(entry)
