"""The fused engine: a batch as one compiled loop, differentiable in its samples."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import PyTree

from .._checks import is_concrete
from .derivative import Derivative, is_real
from .plan import Batch, Plan, joined
from .program import Program

# Lanes that a kernel advances at a time: always as many, so that no bits depend on it.
WIDTH = 32


class Fused:
    """A batch of one plan. Called with samples, it runs; under a transformation of JAX it
    becomes a callback with a derivative of its own, in forward mode: the tangents run in
    the same loop as the values, all directions beside each other."""

    def __init__(
        self,
        plan: Plan,
        samples: PyTree,
        lanes: int,
        steps: int,
        every: int,
        threads: int | None,
    ):
        self.plan, self.lanes, self.steps, self.every = plan, lanes, steps, every
        self.threads = threads
        leaves, self.tree = jax.tree.flatten(samples)
        self.sample = [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in leaves]
        self.state, out = jax.eval_shape(
            lambda leaves: plan.first(self._made(leaves)), self.sample
        )
        self.kept, self.results = out
        self._programs: tuple[Program, Program] | None = None

    def __call__(self, samples: PyTree) -> Batch:
        leaves = jax.tree.leaves(samples)
        if is_concrete(*leaves):
            return jax.tree.map(jnp.asarray, self._run(leaves))
        self._loops()  # compiled here, since a callback should leave JAX alone
        return self._transformed(leaves)

    def _made(self, leaves: list[Any]) -> PyTree:
        return jax.tree.unflatten(self.tree, leaves)

    # -- values --------------------------------------------------------------------------

    def _loops(self) -> tuple[Program, Program]:
        if self._programs is None:

            def begin(k, state, shared, sample, log, lane_log):
                return self.plan.first(self._made(sample))

            def advance(k, state, shared, sample, log, lane_log):
                made = self._made(sample)
                return self.plan.step(k, state, made, self.plan.prepared(made))

            inputs = {"lane": self.sample}
            self._programs = (
                Program.of(begin, self.state, inputs, WIDTH),
                Program.of(advance, self.state, inputs, WIDTH),
            )
        return self._programs

    def _run_with_rates(self, push: Derivative, leaves, rates, directions: int):
        """The tangents of the real results: an axis of lanes, one of directions, theirs."""
        state, begin, advance = push.loops(directions, WIDTH)
        inputs = {"lane": (leaves, rates)}
        last, record = self._execute(begin, advance, state, inputs, len(leaves[0]))
        return [*last, *(np.moveaxis(x, 2, 1) for x in record)]

    def _execute(self, begin: Program, advance: Program, state, inputs, lanes):
        """The last metrics and all records, axes of lanes first."""
        zero = jax.tree.map(lambda s: np.zeros((lanes, *s.shape), s.dtype), state)
        begun, (first, _) = begin(zero, inputs, lanes, 1, threads=self.threads)
        settings = {"every": self.every, "threads": self.threads}
        _, (rest, results) = advance(begun, inputs, lanes, self.steps, **settings)
        first = jax.tree.map(lambda x: x[:, 0], first)
        last = jax.tree.map(lambda x: x[:, -1], results)
        return last, joined(first, rest, 1, np)

    def _run(self, leaves: list[Any]) -> Batch:
        leaves = [np.asarray(x) for x in leaves]
        inputs = {"lane": leaves}
        return Batch(*self._execute(*self._loops(), self.state, inputs, len(leaves[0])))

    # -- under transformations -----------------------------------------------------------

    def _shapes(self, *lead: int) -> Batch:
        """Of the results, with further leading axes."""

        def results(s):
            return jax.ShapeDtypeStruct((*lead, self.lanes, *s.shape), s.dtype)

        def kept(s):
            count = self.steps // self.every + 1
            return jax.ShapeDtypeStruct((*lead, self.lanes, count, *s.shape), s.dtype)

        return Batch(jax.tree.map(results, self.results), jax.tree.map(kept, self.kept))

    def _transformed(self, leaves: list[Any]) -> Batch:
        @jax.custom_jvp
        def run(leaves):
            method = "broadcast_all"
            return jax.pure_callback(
                self._batched, self._shapes(), leaves, vmap_method=method
            )

        def derivative(primals, tangents):
            (leaves,), (rates,) = primals, tangents
            moved = [
                k
                for k, rate in enumerate(rates)
                if is_real(self.sample[k]) and not isinstance(rate, SymbolicZero)
            ]
            out = run(leaves)
            rates = [rates[k] for k in moved]
            push = Derivative(
                self.plan, self.tree, self.sample, self.state, self._loops(), moved
            )
            tangent = jax.pure_callback(
                lambda leaves, rates: self._rates(leaves, push, rates),
                self._float_shapes(),
                leaves,
                rates,
                vmap_method="expand_dims",
            )
            return out, _with_integers(out, tangent)

        run.defjvp(derivative, symbolic_zeros=True)
        return run(leaves)

    def _float_shapes(self) -> list[jax.ShapeDtypeStruct]:
        return [s for s in jax.tree.leaves(self._shapes()) if is_real(s)]

    def _batched(self, leaves: list[Any]) -> Batch:
        """Runs leaves with further axes in front, as more lanes."""
        leaves = [np.asarray(x) for x in leaves]
        lead = leaves[0].shape[: leaves[0].ndim - 1 - len(self.sample[0].shape)]
        flat = [x.reshape(-1, *s.shape) for x, s in zip(leaves, self.sample, strict=True)]
        out = self._run(flat)
        return jax.tree.map(lambda x: x.reshape(*lead, self.lanes, *x.shape[1:]), out)

    def _rates(self, leaves, push: Derivative, rates) -> list[np.ndarray]:
        """The tangents of the real results. Axes in front of size one in every leaf, and
        not in the rates, are directions."""
        leaves = [np.asarray(x) for x in leaves]
        rates = [np.asarray(x) for x in rates]
        extra = leaves[0].ndim - 1 - len(self.sample[0].shape)
        lead = np.broadcast_shapes(*(x.shape[:extra] for x in (*leaves, *rates)))
        fixed = [max(x.shape[a] for x in leaves) for a in range(extra)]
        ahead = [a for a in range(extra) if fixed[a] == 1 < lead[a]]
        kept = [a for a in range(extra) if a not in ahead]
        directions = int(np.prod([lead[a] for a in ahead], dtype=int))
        lanes_lead = [lead[a] for a in kept]

        def flat_leaf(x, s):
            x = np.squeeze(x, tuple(ahead))
            return np.broadcast_to(x, (*lanes_lead, self.lanes, *s.shape)).reshape(
                -1, *s.shape
            )

        def flat_rate(x, s):
            x = np.broadcast_to(x, (*lead, self.lanes, *s.shape))
            x = np.transpose(x, (*kept, extra, *ahead, *range(extra + 1, x.ndim)))
            return x.reshape(-1, directions, *s.shape)

        flat = [flat_leaf(x, s) for x, s in zip(leaves, self.sample, strict=True)]
        moving = [
            flat_rate(x, self.sample[k]) for k, x in zip(push.moved, rates, strict=True)
        ]
        out = []
        for leaf in self._run_with_rates(push, flat, moving, directions):
            # From lanes first and directions second to the order that was asked for.
            shape = (*lanes_lead, self.lanes, *(lead[a] for a in ahead), *leaf.shape[2:])
            order = [
                kept.index(a) if a in kept else len(kept) + 1 + ahead.index(a)
                for a in range(extra)
            ]
            rest = range(extra + 1, len(shape))
            out.append(np.transpose(leaf.reshape(shape), (*order, len(kept), *rest)))
        return out


def _with_integers(out: PyTree, tangent: list[Any]) -> PyTree:
    """The tangents as a tree like `out`; what is no real number has none."""
    leaves, tree = jax.tree.flatten(out)
    given = iter(tangent)
    filled = [
        next(given) if is_real(x) else np.zeros(x.shape, jax.dtypes.float0) for x in leaves
    ]
    return jax.tree.unflatten(tree, filled)
