"""The chosen parameters of a model as one vector, relative to where they start."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._module import Module


class Parameters(Module):
    """Chosen leaves of a model, entry by entry: `value exp(q)`, which keeps its sign, or,
    of an entry that may change it or starts at zero, `value + scale q`.

    - `leaves`: their places among the leaves of `model`; `names` of the entries;
    - `signed`: the entries that may change their sign.
    """

    model: Any
    value: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    leaves: tuple[int, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    signed: tuple[bool, ...] = eqx.field(static=True)

    def entries(self, q: Float[Array, " k"] | Float[np.ndarray, " k"]) -> Any:
        """The values of the entries (their units), shape `(k,)`."""
        xp = np if isinstance(q, np.ndarray) else jnp  # XLA would compile each operation
        signed = np.array(self.signed, bool)
        added = self.value + self.scale * q
        return xp.where(signed, added, self.value * xp.exp(xp.where(signed, 0.0, q)))

    def rates(self, q: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """The slope of every entry in its `q` (their units), shape `(k,)`."""
        return np.where(np.array(self.signed, bool), self.scale, self.entries(q))

    def place(self, q: Float[Array, " k"] | Float[np.ndarray, " k"]) -> Any:
        """The model with these parameters."""
        every, structure = jax.tree.flatten(self.model)
        entries, start = self.entries(q), 0
        for k in self.leaves:
            old = jnp.asarray(every[k])
            new = entries[start : start + old.size].reshape(old.shape)
            every[k] = jnp.asarray(new.astype(old.dtype))
            start += old.size
        return jax.tree.unflatten(structure, every)


def chosen(model: Any, where: Callable[[Any], Any]) -> Parameters:
    """The parameters that `where` selects: a leaf, or several."""
    paths, structure = jax.tree_util.tree_flatten_with_path(model)
    numbered = jax.tree.unflatten(structure, range(len(paths)))
    try:
        places = jax.tree.leaves(where(numbered))
    except (TypeError, IndexError) as error:
        raise ValueError(_WHERE.format(error)) from error
    if not places or not all(type(k) is int for k in places):
        raise ValueError(_WHERE.format(f"it selects {places}"))
    if len(set(places)) < len(places):
        raise ValueError("Argument `where` must select every leaf once, but one is twice.")
    leaves = [paths[k][1] for k in places]
    for k, leaf in zip(places, leaves, strict=True):
        if not (eqx.is_inexact_array_like(leaf)):
            name = jax.tree_util.keystr(paths[k][0])
            raise ValueError(_WHERE.format(f"{name} is {leaf!r}"))
    short = [_last(paths[k][0]) for k in places]
    full = [jax.tree_util.keystr(paths[k][0]).lstrip(".") for k in places]
    full = [path.removeprefix("model.") for path in full]
    names: list[str] = []
    for name, path, leaf in zip(short, full, leaves, strict=True):
        label = name if short.count(name) == 1 else path
        names += [label + (f"[{j}]" if np.ndim(leaf) else "") for j in range(np.size(leaf))]
    value = np.concatenate([np.ravel(np.asarray(leaf, float)) for leaf in leaves])
    signed = tuple(bool(x == 0) or "offset" in n for x, n in zip(value, names, strict=True))
    return Parameters(model, value, np.abs(value), tuple(places), tuple(names), signed)


_WHERE = (
    "Argument `where` must select leaves of the model that are real numbers or arrays of "
    "them, for instance `lambda o: o.relation.resistance`, but {}."
)


def _last(path: Any) -> str:
    if path and isinstance(path[-1], jax.tree_util.DictKey):
        return str(path[-1].key)
    names = [k.name for k in path if isinstance(k, jax.tree_util.GetAttrKey)]
    return names[-1] if names else jax.tree_util.keystr(path)
