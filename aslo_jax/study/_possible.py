"""Spreads that make parameters which cannot be, such as a resistance below zero."""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._leaves import Changed, Place
from ._spread import Sampler

PIECE = 2**16  # samples drawn at once


def refuse_impossible(sampler: Sampler, samples: int) -> None:
    """Refuse a spread of which one of the `samples` has a parameter that its module would
    refuse at construction. Each parameter is looked at with the others as they are.

    **Raises:** `ValueError` that names the parameter of the spread and the share.
    """
    if not sampler.names:
        return
    limits = np.array([np.inf]), np.array([-np.inf])
    for values in _pieces(sampler, samples):
        limits = (
            np.minimum(limits[0], values.min(axis=0)),
            np.maximum(limits[1], values.max(axis=0)),
        )
    middle = np.median(sampler.values(0, min(samples, PIECE)), axis=0)
    for k, name in enumerate(sampler.names):
        low, high = float(limits[0][k]), float(limits[1][k])
        fault = lambda x, k=k: _fault(sampler.make, k, x)
        said = fault(low) or fault(high)
        if said is None:
            continue
        some = next((x for x in (float(middle[k]), 1.0) if fault(x) is None), None)
        if some is None:
            count = samples
        else:
            least = low if fault(low) is None else _edge(fault, some, low)
            most = high if fault(high) is None else _edge(fault, some, high)
            column = (values[:, k] for values in _pieces(sampler, samples))
            count = sum(int(np.sum((x < least) | (x > most))) for x in column)
        raise ValueError(
            f"`spread.{name}` makes parameters that cannot be in {count} of {samples} "
            f"samples ({100.0 * count / samples:.3g} %): {said}; choose another "
            "distribution, or bound a normal one by `low` and `high`."
        )


def _pieces(sampler: Sampler, samples: int) -> Iterator[np.ndarray]:
    for first in range(0, samples, PIECE):
        yield sampler.values(first, min(first + PIECE, samples))


def _edge(fault: Callable[[float], str | None], good: float, bad: float) -> float:
    """The last value without a fault on the way from a good one to a bad one."""
    for _ in range(200):
        middle = good + 0.5 * (bad - good)
        if middle in (good, bad):
            break
        if fault(middle) is None:
            good = middle
        else:
            bad = middle
    return good


def _fault(make: Changed, k: int, value: float) -> str | None:
    """What modules say of the experiment whose `k`-th number is the `value`."""
    layout = make.layout
    for place in make.places[k]:
        leaves = list(layout.leaves)
        leaves[place.leaf] = _set(leaves[place.leaf], place, value, make.relative[k])
        node = jax.tree_util.tree_unflatten(layout.tree, leaves)
        for key in layout.ways[place.leaf]:
            try:
                _check(node)
            except ValueError as error:
                return f"`{layout.paths[place.leaf]}`: {str(error).rstrip('.')}"
            node = _child(node, key)
    return None


def _set(leaf: Any, place: Place, value: float, relative: bool) -> Any:
    leaf = np.array(leaf)
    leaf[place.entry] = leaf[place.entry] * value if relative else value
    return jnp.asarray(leaf)


def _check(node: Any) -> None:
    """As Equinox does at construction."""
    if isinstance(node, eqx.Module):
        for kind in type(node).__mro__:
            if "__check_init__" in vars(kind):
                kind.__check_init__(node)  # pyright: ignore[reportAttributeAccessIssue]


def _child(node: Any, key: Any) -> Any:
    if hasattr(key, "name"):
        return getattr(node, key.name)
    return node[key.key if hasattr(key, "key") else key.idx]
