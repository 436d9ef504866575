"""The loops of a batch with their tangents, in some of the leaves of a sample."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._frontend.lower import flatten
from ..._ir.activity import depends
from ..._ir.loop import Loop
from ..._typing import PyTree
from .plan import Plan
from .program import Bodies, Inputs, Program, flat, trace


class Derivative:
    """The derivative of a plan's loop, whose program of `values` is given, in the leaves
    `moved` of a sample. One direction is traced; `program` puts several beside one run of
    the values: equal operations are kept once in a graph, and so the values are."""

    def __init__(
        self,
        plan: Plan,
        made: Callable[[list[Any]], PyTree],
        sample: list[jax.ShapeDtypeStruct],
        values: Program,
        moved: list[int],
    ) -> None:
        self.plan, self.made, self.sample, self.moved = plan, made, sample, moved
        state = jax.eval_shape(lambda leaves: plan.first(made(leaves))[0], sample)
        self.state_leaves, self.state_tree = jax.tree.flatten(state)
        self.carried = self._moving_state(values.raw)
        bodies = Bodies(self._begin, self._advance, self._finish)
        self._traced = trace(bodies, {"lane": self._lane(())})
        self._programs: dict[int, Program] = {}

    def program(self, directions: int, widths: Sequence[int]) -> Program:
        """The loop of values and tangents, which returns pairs of both: of what is real,
        tangents with a leading axis of directions."""
        if directions not in self._programs:
            self._programs[directions] = self._beside(directions, widths)
        return self._programs[directions]

    def _lane(self, lead: tuple[int, ...]) -> tuple[list, list[jax.ShapeDtypeStruct]]:
        return self.sample, wide([self.sample[k] for k in self.moved], *lead)

    def _moving_state(self, loop: Loop) -> list[int]:
        """The real leaves of the state that may depend on the moved leaves of a sample."""
        edges = _edges(self.sample)
        lanes = {("lane", i) for k in self.moved for i in range(edges[k], edges[k + 1])}
        carried = depends(loop, lanes)
        edges = _edges(self.state_leaves)
        return [
            j
            for j, s in enumerate(self.state_leaves)
            if is_real(s) and any(i in carried for i in range(edges[j], edges[j + 1]))
        ]

    # -- one direction -------------------------------------------------------------------

    def _begin(self, inputs):
        sample, rates = inputs["lane"]

        def run(inner):
            return self.plan.first(self.made(_placed(sample, self.moved, inner)))

        return self._pushed(run, [sample[k] for k in self.moved], rates)

    def _advance(self, k, pair, inputs):
        (state, state_rates), (sample, rates) = pair, inputs["lane"]
        old, count = jax.tree.leaves(state), len(self.carried)

        def run(inner):
            made = self.made(_placed(sample, self.moved, inner[count:]))
            leaves = _placed(old, self.carried, inner[:count])
            state = jax.tree.unflatten(self.state_tree, leaves)
            return self.plan.step(k, state, made, self.plan.prepared(made))

        point = [*(old[j] for j in self.carried), *(sample[k] for k in self.moved)]
        return self._pushed(run, point, [*state_rates, *rates])

    def _finish(self, pair, inputs):
        state, rates = pair
        old = jax.tree.leaves(state)

        def run(inner):
            leaves = _placed(old, self.carried, inner)
            return self.plan.results(jax.tree.unflatten(self.state_tree, leaves))

        out, rate = jax.jvp(run, ([old[j] for j in self.carried],), (rates,))
        return out, _of_real(rate, out)

    def _pushed(self, run: Callable, point: list[Any], rates: list[Any]):
        """The next values and tangents, and those of what is kept."""
        (state, kept), (state_rate, rate) = jax.jvp(run, (point,), (rates,))
        moving = [jax.tree.leaves(state_rate)[j] for j in self.carried]
        return (state, moving), (kept, _of_real(rate, kept))

    # -- several ones --------------------------------------------------------------------

    def _beside(self, directions: int, widths: Sequence[int]) -> Program:
        traced, lead = self._traced, (directions,)
        tangents = wide([self.state_leaves[j] for j in self.carried], *lead)
        carry = (self.state_leaves, tangents)
        given = Inputs(carry, {"lane": self._lane(lead)})
        size, samples = len(self.state_leaves), len(self.sample)
        count = size + len(self.carried)

        def of_direction(numbers: list[np.ndarray], shared: int, d: int):
            return [*numbers[:shared], *(np.asarray(r[d]) for r in numbers[shared:])]

        outs: list[list[list[np.ndarray]]] = [[], [], []]
        for d in range(directions):
            state = of_direction(given.carry, size, d)
            lane = of_direction(given.fixed, samples, d)
            arguments = lane, [given.step, *state, *lane], [*state, *lane]
            jaxprs = traced.begin, traced.advance, traced.finish
            for out, closed, inputs in zip(outs, jaxprs, arguments, strict=True):
                out.append(flatten(given.graph, closed, inputs))

        def together(out: list[list[np.ndarray]], *pairs: PyTree) -> list[np.ndarray]:
            """Of pairs of values and tangents, the former once."""
            of_values = [v for pair in pairs for v in _flags(pair)]
            columns = zip(of_values, zip(*out, strict=True), strict=True)
            return [every[0] if shared else np.stack(every) for shared, every in columns]

        pairs = (carry, traced.record)
        begin, advance = (together(out, *pairs) for out in outs[:2])
        final = together(outs[2], traced.final)
        loop = Loop(
            given.graph,
            flat(begin[:count]),
            flat(advance[:count]),
            record=flat(advance[count:]),
            first=flat(begin[count:]),
            final=flat(final),
            branches=tuple(given.graph.branches),
        )
        record, final = (
            (values, wide(rates, *lead)) for values, rates in (traced.record, traced.final)
        )
        return Program(loop, record, final, widths)


def _flags(pair: tuple[PyTree, PyTree]) -> list[bool]:
    """For every leaf of values and tangents, whether it is a value."""
    values, rates = (len(jax.tree.leaves(tree)) for tree in pair)
    return [True] * values + [False] * rates


def _of_real(rate: PyTree, value: PyTree) -> list[Any]:
    """The tangents of the leaves that are real numbers."""
    pairs = zip(jax.tree.leaves(rate), jax.tree.leaves(value), strict=True)
    return [r for r, x in pairs if is_real(x)]


def wide(shapes: PyTree, *lead: int) -> PyTree:
    """Shapes and types with further axes in front."""
    return jax.tree.map(lambda s: jax.ShapeDtypeStruct((*lead, *s.shape), s.dtype), shapes)


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
