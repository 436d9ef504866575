"""The fused engine: a batch as one compiled loop, differentiable in its samples."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import PyTree

from .._checks import is_concrete
from .derivative import Derivative, is_real
from .plan import Batch, Plan
from .program import Bodies, Program, width


class Fused:
    """A batch of one plan, `like` the shapes of one of its samples. Called with samples, it
    runs; under a transformation of JAX it becomes a callback with a derivative of its own,
    in forward mode: the tangents run in the same loop as the values, all directions beside
    each other."""

    def __init__(
        self, plan: Plan, like: PyTree, steps: int, every: int, threads: int | None
    ):
        self.plan, self.steps, self.every, self.threads = plan, steps, every, threads
        self.sample, self.tree = jax.tree.flatten(like)

    def __getstate__(self) -> dict[str, Any]:
        """What runs; derivatives are for the process where it was made."""
        self.program  # noqa: B018  traced here
        return vars(self) | {"plan": None}

    def __call__(self, samples: PyTree) -> Batch:
        leaves = jax.tree.leaves(samples)
        if is_concrete(*leaves):
            return jax.tree.map(jnp.asarray, self._run(leaves))
        self.program  # noqa: B018  traced here, since a callback should leave JAX alone
        return self._transformed(leaves)

    def made(self, leaves: list[Any]) -> PyTree:
        return jax.tree.unflatten(self.tree, leaves)

    # -- values --------------------------------------------------------------------------

    @functools.cached_property
    def program(self) -> Program:
        """The loop, traced when it is first asked for, and compiled when first called."""

        def advance(k, state, inputs):
            sample = self.made(inputs["lane"])
            return self.plan.step(k, state, sample, self.plan.prepared(sample))

        bodies = Bodies(
            lambda inputs: self.plan.first(self.made(inputs["lane"])),
            advance,
            lambda state, inputs: self.plan.results(state),
        )
        return Program.of(bodies, {"lane": self.sample}, width())

    def _run_with_rates(self, push: Derivative, leaves, rates, directions: int):
        """The tangents of the real results: an axis of lanes, one of directions, theirs."""
        program = push.program(directions, width())
        record, final = self._execute(program, {"lane": (leaves, rates)}, leaves[0])
        return [*final, *(np.moveaxis(x, 2, 1) for x in record)]

    def _run(self, leaves: list[Any]) -> Batch:
        leaves = [np.asarray(x) for x in leaves]
        record, final = self._execute(self.program, {"lane": leaves}, leaves[0])
        return Batch(final, record)

    def _execute(self, program: Program, inputs: PyTree, like: np.ndarray):
        settings = {"every": self.every, "threads": self.threads}
        return program(inputs, len(like), self.steps, **settings)

    # -- under transformations -----------------------------------------------------------

    def _shapes(self, lanes: int) -> Batch:
        """Of the results."""

        def wide(tree, *lead):
            return jax.tree.map(
                lambda s: jax.ShapeDtypeStruct((*lead, *s.shape), s.dtype), tree
            )

        rows = self.steps // self.every + 1
        program = self.program
        return Batch(wide(program.final, lanes), wide(program.record, lanes, rows))

    def _transformed(self, leaves: list[Any]) -> Batch:
        shapes = self._shapes(leaves[0].shape[0])

        @jax.custom_jvp
        def run(leaves):
            method = "broadcast_all"
            return jax.pure_callback(self._batched, shapes, leaves, vmap_method=method)

        def derivative(primals, tangents):
            (leaves,), (rates,) = primals, tangents
            moved = [
                k
                for k, rate in enumerate(rates)
                if is_real(self.sample[k]) and not isinstance(rate, SymbolicZero)
            ]
            out = run(leaves)
            rates = [rates[k] for k in moved]
            push = Derivative(self.plan, self.made, self.sample, self.program, moved)
            tangent = jax.pure_callback(
                lambda leaves, rates: self._rates(leaves, push, rates),
                [s for s in jax.tree.leaves(shapes) if is_real(s)],
                leaves,
                rates,
                vmap_method="expand_dims",
            )
            return out, _with_integers(out, tangent)

        run.defjvp(derivative, symbolic_zeros=True)
        return run(leaves)

    def _batched(self, leaves: list[Any]) -> Batch:
        """Runs leaves with further axes in front, as more lanes."""
        leaves = [np.asarray(x) for x in leaves]
        lead = leaves[0].shape[: leaves[0].ndim - 1 - len(self.sample[0].shape)]
        flat = [x.reshape(-1, *s.shape) for x, s in zip(leaves, self.sample, strict=True)]
        out = self._run(flat)
        return jax.tree.map(lambda x: x.reshape(*lead, -1, *x.shape[1:]), out)

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
        lanes = leaves[0].shape[extra]
        lanes_lead = [lead[a] for a in kept]

        def flat_leaf(x, s):
            x = np.squeeze(x, tuple(ahead))
            return np.broadcast_to(x, (*lanes_lead, lanes, *s.shape)).reshape(-1, *s.shape)

        def flat_rate(x, s):
            x = np.broadcast_to(x, (*lead, lanes, *s.shape))
            x = np.transpose(x, (*kept, extra, *ahead, *range(extra + 1, x.ndim)))
            return x.reshape(-1, directions, *s.shape)

        flat = [flat_leaf(x, s) for x, s in zip(leaves, self.sample, strict=True)]
        moving = [
            flat_rate(x, self.sample[k]) for k, x in zip(push.moved, rates, strict=True)
        ]
        out = []
        for leaf in self._run_with_rates(push, flat, moving, directions):
            # From lanes first and directions second to the order that was asked for.
            shape = (*lanes_lead, lanes, *(lead[a] for a in ahead), *leaf.shape[2:])
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
