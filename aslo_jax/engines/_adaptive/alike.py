"""A system traced once, as a vector of states: those that are always equal are integrated
once, the two halves of a symmetric matrix, or filters that observers have in common."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from ..._frontend.lower import flatten
from ..._frontend.outlining import name_of
from ..._ir.graph import Graph
from ..._ir.rewrite import rebuilt
from ..._typing import PyTree
from .._fused.program import flat, numbered
from .stepper import Field
from .switches import switched, switches


class States(NamedTuple):
    """`like`, the shapes of the tree of states; `first`, shape `(m,)`, where each of those
    that differ is among all, and `of`, shape `(n,)`, which of these each state is; `init`,
    the first state, and `field`, its derivative, traced before; `functions`, one for each
    name that the derivative has been given. Of the switching functions that it declares,
    `switches`, shape `(k,)`, is which of those that differ each is."""

    like: PyTree
    first: np.ndarray
    of: np.ndarray
    init: Callable[[PyTree], PyTree]
    field: Any
    switches: np.ndarray
    functions: dict[str, Callable[..., Any]]

    def start(self, given: PyTree) -> Any:
        """The first state, shape `(m,)`."""
        return self._packed(self.init(given))

    def field_at(self, given: PyTree, times: int) -> Field:
        """The derivative at a state, both of shape `(m,)`, a function in machine code too
        where it is evaluated so many `times`."""
        rate = functools.partial(self.named(times), jax.tree.leaves(given))
        n, count = len(self.first), len(set(self.switches.tolist()))
        if not count:
            return Field(lambda t, x, sides: (rate(t, x), None))

        def field(t, x, sides):
            found = rate(t, jnp.concatenate([x, sides]))
            return found[:n], found[n:]

        return Field(field, count)

    def named(self, times: int) -> Callable[[list[Any], Any, Any], Any]:
        """One function for all that call it, of which JAX keeps the trace: of the leaves of
        what is given, of t, and of the state with the sides of switching functions behind
        it; the derivative, and behind it the values of these."""
        name = name_of(times)
        if name not in self.functions:
            n, of = len(self.first), self.switches
            first = np.unique(of, return_index=True)[1]

            def rate(leaves, t, z):
                moving = [*leaves, t, *jax.tree.leaves(self.tree(z[:n]))]
                if not len(of):
                    return self._packed(jex.jaxpr_as_fun(self.field)(*moving))
                rates, values = switched(self.field, moving, z[n:][of])
                return jnp.concatenate([self._packed(rates), values[first]])

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
    init = jax.jit(init)  # of which JAX keeps the trace
    given = jax.tree.map(lambda x: jax.ShapeDtypeStruct(jnp.shape(x), x.dtype), given)
    begin, start = jax.make_jaxpr(init, return_shape=True)(given)
    t = jax.ShapeDtypeStruct((), jnp.result_type(float))
    moving = jax.make_jaxpr(rate)(given, t, start)
    graph = Graph()
    fixed, x = numbered(graph, "lane", given), numbered(graph, "carry", start)
    now = np.asarray(graph.input(t.dtype, ("step", 0)))
    own = flat(x)
    begun = flat(flatten(graph, begin, fixed))
    inputs = [*fixed, now, *x]
    after = flat(flatten(graph, moving, inputs))
    alike = _switches(graph, moving, inputs)
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
    return States(start, np.array(kept, int), of, init, moving, alike, {})


def _switches(graph: Graph, moving: Any, inputs: list[Any]) -> np.ndarray:
    """Of the switching functions of a vector field, which of those that differ each is."""
    count = switches(moving)
    if not count:
        return np.empty(0, int)
    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in moving.jaxpr.invars]
    values = lambda *given: switched(moving, given, jnp.zeros(count))[1]
    numbers = flat(flatten(graph, jax.make_jaxpr(values)(*shapes), inputs))
    return np.unique(numbers, return_inverse=True)[1].reshape(-1)
