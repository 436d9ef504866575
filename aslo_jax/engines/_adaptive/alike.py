"""A system traced once, as a vector of states: those that are always equal are integrated
once, the two halves of a symmetric matrix, or filters that observers have in common."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._frontend.lower import flatten
from ..._frontend.outlining import name_of
from ..._ir.graph import Graph
from ..._ir.rewrite import rebuilt
from ..._typing import PyTree
from .._fused.program import flat, numbered


class States(NamedTuple):
    """`like`, the shapes of the tree of states; `first`, shape `(m,)`, where each of those
    that differ is among all, and `of`, shape `(n,)`, which of these each state is; `init`
    and `field`, the first state and its derivative, traced before; `functions`, one for
    each name that the derivative has been given."""

    like: PyTree
    first: np.ndarray
    of: np.ndarray
    init: Callable[[PyTree], PyTree]
    field: Callable[[PyTree, Any, PyTree], PyTree]
    functions: dict[str, Callable[..., Any]]

    def start(self, given: PyTree) -> Any:
        """The first state, shape `(m,)`."""
        return self._packed(self.init(given))

    def rate(self, given: PyTree, t: Any, x: Any) -> Any:
        """The derivative at a state, both of shape `(m,)`."""
        return self._packed(self.field(given, t, self.tree(x)))

    def field_at(self, given: PyTree, times: int) -> Callable[[Any, Any], Any]:
        """[`rate`][] as a function of t and x, a function in machine code too where it is
        evaluated so many `times`."""
        return functools.partial(self.named(times), given)

    def named(self, times: int) -> Callable[[PyTree, Any, Any], Any]:
        """One function for all that call it, of which JAX keeps the trace."""
        name = name_of(times)
        if name not in self.functions:

            def rate(given, t, x):
                return self.rate(given, t, x)

            rate.__name__ = name
            self.functions[name] = jax.jit(rate)
        return self.functions[name]

    def tree(self, x: Any) -> PyTree:
        """Of a vector of shape `(m,)`."""
        leaves, tree = jax.tree.flatten(self.like)
        x = x if len(self.of) == len(self.first) else x[self.of]
        ends = np.cumsum([leaf.size for leaf in leaves])[:-1]
        pieces = jnp.split(x, ends) if leaves else []
        return jax.tree.unflatten(
            tree,
            [
                p.reshape(s.shape).astype(s.dtype)
                for p, s in zip(pieces, leaves, strict=True)
            ],
        )

    def _packed(self, tree: PyTree) -> Any:
        x = jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])
        return x if len(self.of) == len(self.first) else x[self.first]


def traced(
    init: Callable[[PyTree], PyTree], rate: Callable[[PyTree, Any, PyTree], PyTree]
) -> Callable[[PyTree], States]:
    """A function of what is constant in time that gives the states of a system, traced when
    it is first called: `init(given)` is the first one, a tree, and `rate(given, t, state)`
    its derivative."""
    known: list[States] = []

    def states(given: PyTree) -> States:
        if not known:
            known.append(_found(init, rate, given))
        return known[0]

    return states


def _found(init: Callable, rate: Callable, given: PyTree) -> States:
    """The coarsest partition whose parts begin alike and go on alike, as that of the carry
    of a loop (congruence of loop-carried values)."""
    init, rate = jax.jit(init), jax.jit(rate)  # of which JAX keeps the traces
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
    of = np.array([place[k] for k in first], int)
    return States(start, np.array(kept, int), of, init, rate, {})
