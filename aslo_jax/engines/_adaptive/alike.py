"""States that are always equal, which are integrated once: the two halves of a symmetric
matrix, or the filters that several observers have in common."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..._typing import PyTree
from .._frontend.lower import flatten
from .._fused.program import flat, numbered
from .._ir.graph import Graph
from .._ir.rewrite import rebuilt


class States(NamedTuple):
    """A tree of states as a vector of those that differ: `first`, shape `(m,)`, where each
    of these is in the whole vector, and `of`, shape `(n,)`, which of these each state is."""

    first: np.ndarray
    of: np.ndarray

    def packed(self, tree: PyTree) -> tuple[Any, Callable[[Any], PyTree]]:
        """The vector of a tree, shape `(m,)`, and the tree of such a vector."""
        whole, back = ravel_pytree(tree)
        if len(self.first) == len(self.of):
            return whole, back
        return whole[self.first], lambda x: back(jnp.asarray(x)[self.of])


    @staticmethod
    def of_system(
        init: Callable[[PyTree], PyTree], rate: Callable[[PyTree, Any, PyTree], PyTree]
    ) -> "Callable[[PyTree], States]":
        """A function of what is constant in time that gives those of a system, found once:
        `init(given)` is its first state, a tree, and `rate(given, t, state)` its derivative.

        The coarsest partition whose parts begin alike and go on alike, as that of the carry
        of a loop (congruence of loop-carried values)."""
        known: list[States] = []

        def states(given: PyTree) -> States:
            if not known:
                known.append(_found(init, rate, given))
            return known[0]

        return states


def _found(init: Callable, rate: Callable, given: PyTree) -> States:
    given = jax.tree.map(lambda x: jax.ShapeDtypeStruct(jnp.shape(x), x.dtype), given)
    begin, start = jax.make_jaxpr(init, return_shape=True)(given)
    t = jax.ShapeDtypeStruct((), jnp.result_type(float))
    moving = jax.make_jaxpr(rate)(given, t, start)
    graph = Graph()
    fixed, x = numbered(graph, "lane", given), numbered(graph, "carry", start)
    now = np.asarray(graph.input(t.dtype, ("step", 0)))
    own = flat(x)
    begun = flat(flatten(graph, begin, fixed))
    after = flat(flatten(graph, moving, [*fixed, now, *x]))
    group: list[Any] = [(graph.dtype(n), b) for n, b in zip(own, begun, strict=True)]
    while True:
        leader = {g: i for i, g in reversed(list(enumerate(group)))}
        first = [leader[g] for g in group]
        same = {n: own[k] for n, k in zip(own, first, strict=True)}
        found = rebuilt(graph, after, same)
        following = [(k, found[n]) for k, n in zip(first, after, strict=True)]
        if len(set(following)) == len(set(group)):
            break
        group = following
    kept = sorted(set(first))
    place = {k: i for i, k in enumerate(kept)}
    return States(np.array(kept, int), np.array([place[k] for k in first], int))
