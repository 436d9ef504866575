"""The loops of a batch with their tangents, in some of the leaves of a sample."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .dependence import depends
from .flatten import flatten
from .plan import Plan
from .program import Program, Traced, numbered, trace


class Derivative:
    """The derivative of a plan's loops in the leaves `moved` of a sample, one direction of
    which is traced. `loops` puts several directions beside one run of the values: equal
    operations are kept once in a graph, and so the values are."""

    def __init__(
        self,
        plan: Plan,
        tree: Any,
        sample: list[jax.ShapeDtypeStruct],
        state: PyTree,
        values: tuple[Program, Program],
        moved: list[int],
    ):
        self.plan, self.tree, self.sample, self.moved = plan, tree, sample, moved
        self.state = state
        self.state_leaves, self.state_tree = jax.tree.flatten(state)
        self.carried = self._moving_state(*values)
        self._traced = tuple(
            trace(body, self._pair(()), {"lane": self._lane(())})
            for body in (self._begin, self._advance)
        )
        self._loops: dict[int, tuple[PyTree, Program, Program]] = {}

    def loops(self, directions: int, width: int) -> tuple[PyTree, Program, Program]:
        """Shapes of the state, that with the tangents of its leaves that move, and the
        loops over it that begin and advance it."""
        if directions not in self._loops:
            state = self._pair((directions,))
            begin, advance = (self._program(t, directions, width) for t in self._traced)
            self._loops[directions] = (state, begin, advance)
        return self._loops[directions]

    def _made(self, leaves: list[Any]) -> PyTree:
        return jax.tree.unflatten(self.tree, leaves)

    def _pair(self, lead: tuple[int, ...]) -> tuple[PyTree, list[jax.ShapeDtypeStruct]]:
        return self.state, [_wide(self.state_leaves[j], lead) for j in self.carried]

    def _lane(self, lead: tuple[int, ...]) -> tuple[list, list[jax.ShapeDtypeStruct]]:
        return self.sample, [_wide(self.sample[k], lead) for k in self.moved]

    def _moving_state(self, begin: Program, advance: Program) -> list[int]:
        """The real leaves of the state that may depend on the moved leaves of a sample."""
        edges = _edges(self.sample)
        lanes = {("lane", i) for k in self.moved for i in range(edges[k], edges[k + 1])}
        carried = set(np.flatnonzero(depends(begin.loop, lanes)).tolist())
        while True:
            sources = lanes | {("carry", i) for i in carried}
            more = carried | set(np.flatnonzero(depends(advance.loop, sources)).tolist())
            if more == carried:
                break
            carried = more
        edges = _edges(self.state_leaves)
        return [
            j
            for j, s in enumerate(self.state_leaves)
            if is_real(s) and any(i in carried for i in range(edges[j], edges[j + 1]))
        ]

    # -- one direction -------------------------------------------------------------------

    def _begin(self, k, pair, shared, lane, log, lane_log):
        sample, rates = lane

        def run(inner):
            return self.plan.first(self._made(_placed(sample, self.moved, inner)))

        return self._pushed(run, [sample[k] for k in self.moved], rates)

    def _advance(self, k, pair, shared, lane, log, lane_log):
        (state, state_rates), (sample, rates) = pair, lane
        old, count = jax.tree.leaves(state), len(self.carried)

        def run(inner):
            made = self._made(_placed(sample, self.moved, inner[count:]))
            leaves = _placed(old, self.carried, inner[:count])
            state = jax.tree.unflatten(self.state_tree, leaves)
            return self.plan.step(k, state, made, self.plan.prepared(made))

        point = [*(old[j] for j in self.carried), *(sample[k] for k in self.moved)]
        return self._pushed(run, point, [*state_rates, *rates])

    def _pushed(self, run: Callable, point: list[Any], rates: list[Any]):
        """The next values and tangents, and the tangents of the real results."""
        (state, out), (state_rate, rate) = jax.jvp(run, (point,), (rates,))
        moving = [jax.tree.leaves(state_rate)[j] for j in self.carried]
        kept = [
            [r for r, x in zip(*map(jax.tree.leaves, pair), strict=True) if is_real(x)]
            for pair in zip(rate, out, strict=True)
        ]
        return (state, moving), tuple(kept)

    # -- several ones --------------------------------------------------------------------

    def _program(self, traced: Traced, directions: int, width: int) -> Program:
        pair = self._pair((directions,))
        graph, numbers = numbered(pair, {"lane": self._lane((directions,))})
        size, samples = len(self.state_leaves), len(self.sample)
        carry, lane = numbers["carry"], numbers["lane"]
        outs = []
        for d in range(directions):
            arguments = [
                *numbers["step"],
                *carry[:size],
                *(np.asarray(rate[d]) for rate in carry[size:]),
                *lane[:samples],
                *(np.asarray(rate[d]) for rate in lane[samples:]),
            ]
            outs.append(flatten(graph, traced.closed, arguments))
        wide = [np.stack(each) for each in zip(*(out[size:] for out in outs), strict=True)]
        record = jax.tree.map(lambda s: _wide(s, (directions,)), traced.record)
        return Program(graph, pair, record, [*outs[0][:size], *wide], width)


def _wide(s: jax.ShapeDtypeStruct, lead: tuple[int, ...]) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((*lead, *s.shape), s.dtype)


def _edges(shapes: list[jax.ShapeDtypeStruct]) -> np.ndarray:
    """Where the entries of each leaf begin among those of all."""
    return np.cumsum([0, *(int(np.prod(s.shape, dtype=int)) for s in shapes)])


def _placed(leaves: list[Any], places: list[int], values: list[Any]) -> list[Any]:
    out = list(leaves)
    for place, value in zip(places, values, strict=True):
        out[place] = value
    return out


def is_real(x: Any) -> bool:
    """Whether x, an array or its shape and type, holds floating-point numbers."""
    return bool(jnp.issubdtype(x.dtype, jnp.floating))
