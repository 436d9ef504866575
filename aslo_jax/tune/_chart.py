"""What a designer looks at: a loss over two leaves, a front of two costs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import random
from .._typing import PyTree
from ._coordinates import Coordinates
from ._descent import Descent, Limits, progress_bar
from ._fit import Loss, default_optimiser
from ._gradients import slope


class Surface(NamedTuple):
    """A loss over two leaves: `loss[i, j]`, shape `(I, J)`, at `first[i]`, shape `(I,)`,
    and `second[j]`, shape `(J,)`.
    """

    first: Float[np.ndarray, " I"]
    second: Float[np.ndarray, " J"]
    loss: Float[np.ndarray, "I J"]


def surface(
    tree: PyTree,
    loss: Loss,
    *,
    where: Callable[[PyTree], Any],
    first: Sequence[float] | np.ndarray,
    second: Sequence[float] | np.ndarray,
    key: random.Key | None = None,
) -> Surface:
    """The `loss` of `tree` with its two leaves `where(tree)`, scalars, at every pair of the
    values `first` and `second`, with the random numbers of [`fit`][] for the same `key`.

    **Raises:** `ValueError` where `where` does not select two numbers.
    """
    key = random.key(0) if key is None else key
    first, second = np.asarray(first, float), np.asarray(second, float)
    if len(where(tree)) != 2 or any(jnp.ndim(x) for x in where(tree)):
        raise ValueError("Argument `where` must select two leaves, each a number.")

    @jax.jit
    @jax.vmap
    def row(pair):
        return loss(eqx.tree_at(where, tree, (pair[0], pair[1])), key)

    rows = [row(jnp.stack([jnp.full(second.shape, a), second], axis=1)) for a in first]
    return Surface(first, second, np.stack([np.asarray(r) for r in rows]))


class Front(NamedTuple):
    """Points of a Pareto front, one for each of the `weights`: the two `costs`, shape
    `(K, 2)`, the same on fresh samples in `validation`, and the `parameters`, `(K, P)`."""

    weights: Float[np.ndarray, " K"]
    costs: Float[np.ndarray, "K 2"]
    validation: Float[np.ndarray, "K 2"]
    parameters: Float[np.ndarray, "K P"]


def pareto(
    tree: PyTree,
    costs: Callable[[PyTree, random.Key], Float[Array, " 2"]],
    *,
    where: Callable[[PyTree], Any],
    weights: Sequence[float] | np.ndarray,
    key: random.Key | None = None,
    optimiser: Any = None,
    bounds: Any = None,
    steps: int = 60,
    tolerance: float = 1e-4,
) -> Front:
    """The front of two positive costs `costs(tree, key)`, shape `(2,)`, such as a settling
    time and a variance: for each weight w in [0, 1] the leaves `where(tree)` that minimise
    `costs[0]^(1 - w) costs[1]^w`, which no units enter. Where the front is not convex in
    the logarithms, points are left out.

    Compiled once for all weights; each descent starts where the last one ended. Derivatives
    are in forward mode.

    - `weights`: the values of w;
    - `steps`: at most as many iterations for each weight; `tolerance`: a descent has
      converged where the slope of that product is below this part of it;
    - `key`, `optimiser`, `bounds`: as in [`fit`][].

    **Raises:** `ValueError` for `weights` out of [0, 1], and as [`fit`][].
    """
    key = random.key(0) if key is None else key
    weights = np.asarray(weights, float)
    if not ((weights >= 0) & (weights <= 1)).all():
        raise ValueError(
            f"Argument `weights` must lie in [0, 1], but got {weights.tolist()}."
        )
    coordinates = Coordinates(tree, where, bounds, "auto")

    def mixed(z, data):
        key, weight = data
        first, second = costs(coordinates.placed(z), key)
        return (1.0 - weight) * jnp.log(first) + weight * jnp.log(second)

    # Its gradient counts as such: the logarithms are already relative.
    limits = Limits(steps, tolerance, 1e-8, 10, relative=False)
    descent = Descent(slope(mixed, "forward"), default_optimiser(optimiser), limits)
    both = jax.jit(lambda z, key: costs(coordinates.placed(z), key))
    values = jax.jit(coordinates.values)
    advance, _ = progress_bar(0, False)
    z, rows = coordinates.inverse(coordinates.start), []
    for weight in weights:
        path, history = descent.run(z, (key, jnp.asarray(weight)), advance)
        z = path[history.best]
        there = jnp.asarray(z)
        fresh = both(there, random.fold(key, 1))
        rows.append((both(there, key), fresh, values(there)))
    found = [
        np.stack([np.asarray(x) for x in column]) for column in zip(*rows, strict=True)
    ]
    return Front(weights, *found)
