"""The fused engine: a batch as one compiled loop, differentiable in its samples."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..._checks import is_concrete
from ..._typing import PyTree
from .._runtime.host import widths
from .forward_only import forward_only, second
from .plan import Batch, Plan
from .program import Bodies, Program
from .refusal import refusal
from .tangents import Derivative, is_real, wide


class Fused:
    """A batch of one plan, `like` the shapes of one of its samples. Called with samples, it
    runs; under a transformation of JAX it becomes a callback with a derivative of its own,
    in forward mode: one run gives the values and, beside them, the tangents of all
    directions.

    `otherwise(error, samples)` runs what fails to compile; None: it is raised."""

    def __init__(
        self,
        plan: Plan,
        like: PyTree,
        steps: int,
        every: int,
        threads: int | None,
        otherwise: Callable[[Exception, PyTree], Batch] | None = None,
    ) -> None:
        self.plan, self.steps, self.every, self.threads = plan, steps, every, threads
        self.otherwise = otherwise
        self.sample, self.tree = jax.tree.flatten(like)

    def __getstate__(self) -> dict[str, Any]:
        """What runs; derivatives are for the process where it was made."""
        self.program  # noqa: B018  traced here
        return vars(self) | {"plan": None, "otherwise": None}

    def __call__(self, samples: PyTree) -> Batch:
        leaves = jax.tree.leaves(samples)
        if not len(leaves[0]):
            nothing = lambda s: jnp.zeros(s.shape, s.dtype)
            return jax.tree.map(nothing, self._shapes(0))
        if not is_concrete(*leaves):
            self.program  # noqa: B018  traced here: a callback should leave JAX alone
            return self._transformed(leaves)
        failure = self._failure()
        if failure is not None:
            return self._resort(failure, leaves)
        return jax.tree.map(jnp.asarray, _checked(self._run(leaves)))

    def _failure(self) -> Exception | None:
        """Compiles the loop, and returns what that raises."""
        try:
            self.program.compile()
        except Exception as error:
            return error
        return None

    def _resort(self, error: Exception, leaves: list[Any]) -> Batch:
        if self.otherwise is None:
            raise refusal(error)
        return self.otherwise(error, self.made(leaves))

    def made(self, leaves: list[Any]) -> PyTree:
        return jax.tree.unflatten(self.tree, leaves)

    # -- values --------------------------------------------------------------------------

    @functools.cached_property
    def program(self) -> Program:
        """The loop, traced when it is first asked for, and compiled when first called."""

        def advance(k, state, inputs, prepared):
            return self.plan.step(k, state, self.made(inputs["lane"]), prepared)

        bodies = Bodies(
            lambda inputs: self.plan.begun(self.made(inputs["lane"])),
            advance,
            lambda state, inputs: self.plan.results(state),
        )
        program = Program.of(bodies, {"lane": self.sample}, widths())
        if jax.tree.leaves(program.record) and not program.raw.first:
            raise ValueError(
                "`record` must return as much at t = 0 as later, but got None."
            )
        return program

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
        rows, program = self.steps // self.every + 1, self.program
        return Batch(wide(program.final, lanes), wide(program.record, lanes, rows))

    def _transformed(self, leaves: list[Any]) -> Batch:
        run = jax.custom_jvp(self._values())

        def derivative(primals, tangents):
            (leaves,), (rates,) = primals, tangents
            moved = [
                k
                for k, rate in enumerate(rates)
                if is_real(self.sample[k]) and not isinstance(rate, SymbolicZero)
            ]
            given = [forward_only(rates[k]) for k in moved]
            try:
                push = self._pushed(moved)
            except Exception as error:
                if self.otherwise is None:
                    raise
                failure = error
            else:
                out, tangent = push(leaves, [rate[None] for rate in given])
                return out, _with_integers(out, [x[0] for x in tangent])

            def resorted(inner):
                every = dict(enumerate(leaves)) | dict(zip(moved, inner, strict=True))
                return self._resort(failure, list(every.values()))

            return jax.jvp(resorted, ([leaves[k] for k in moved],), (given,))

        run.defjvp(derivative, symbolic_zeros=True)
        return run(leaves)

    def _values(self) -> Callable[[list[Any]], Batch]:
        """From the samples to the results, where further axes are more lanes."""

        @jax.custom_batching.custom_vmap
        def values(leaves):
            failure = self._failure()
            if failure is not None:
                return self._resort(failure, leaves)
            return jax.pure_callback(self._run, self._shapes(len(leaves[0])), leaves)

        @values.def_vmap
        def batched(size, axes, leaves):
            if not size:
                shapes = self._shapes(_length(leaves, axes[0]))
                return _nothing(shapes), jax.tree.map(lambda _: True, shapes)
            out = values(_more(leaves, axes[0], size, 0))
            out = jax.tree.map(lambda x: _fewer(x, size, 0), out)
            return out, jax.tree.map(lambda _: True, out)

        return values

    def _pushed(self, moved: list[int]) -> Callable[..., tuple[Batch, list[Any]]]:
        """From the samples, and the tangents of the leaves `moved` with a leading axis of
        directions, to the results and the tangents of the real ones, all of one run.

        Further axes are more lanes, or more directions where only the tangents have them:
        the results do not have them either then."""
        if self.plan is None:
            raise NotImplementedError(
                "A runner of the fused engine that was sent to another process has values "
                'only: there, make another one for derivatives, or with engine="scan".'
            )
        push = Derivative(self.plan, self.made, self.sample, self.program, moved)
        push.program(1, widths())  # what cannot be compiled is refused here

        def run(leaves, rates):
            directions = len(rates[0])
            program = push.program(directions, widths())
            rates = [np.moveaxis(np.asarray(x), 0, 1) for x in rates]
            lane = [np.asarray(x) for x in leaves], rates
            record, final = self._execute(program, {"lane": lane}, lane[0][0])
            (record, record_rates), (final, final_rates) = record, final
            rates = (np.moveaxis(x, 1, 0) for x in final_rates)
            kept = (np.moveaxis(x, 2, 0) for x in record_rates)
            return Batch(final, record), [*rates, *kept]

        def shapes(lanes, directions):
            values = self._shapes(lanes)
            real = [s for s in jax.tree.leaves(values) if is_real(s)]
            return values, wide(real, directions)

        @jax.custom_batching.custom_vmap
        def beside(leaves, rates):
            expected = shapes(len(leaves[0]), len(rates[0]))
            return jax.pure_callback(run, expected, leaves, rates)

        @beside.def_vmap
        def batched(size, axes, leaves, rates):
            if not size:
                given = shapes(_length(leaves, axes[0]), _length(rates, axes[1]))
                return _nothing(given), jax.tree.map(lambda _: True, given)
            lanes = any(axes[0])
            if lanes:
                leaves = _more(leaves, axes[0], size, 0)
            out, tangent = pushed(leaves, _more(rates, axes[1], size, int(lanes)))
            if lanes:
                out = jax.tree.map(lambda x: _fewer(x, size, 0), out)
            tangent = [_fewer(x, size, int(lanes)) for x in tangent]
            return (out, tangent), (
                jax.tree.map(lambda _: lanes, out),
                [True] * len(tangent),
            )

        pushed = jax.custom_jvp(beside)
        pushed.defjvp(second)
        return pushed


def _checked(batch: Batch) -> Batch:
    """Refuses results, as `jax.jit` does, under JAX's `debug_nans` and `debug_infs`."""
    for name, bad in (("nan", np.isnan), ("inf", np.isinf)):
        if not getattr(jax.config, f"jax_debug_{name}s"):
            continue
        for leaf in jax.tree.leaves(batch):
            if is_real(leaf) and bad(leaf).any():
                raise FloatingPointError(
                    f"invalid value ({name}) encountered in a result of the fused engine"
                )
    return batch


def _more(arrays: list[Any], batched: list[bool], size: int, axis: int) -> list[Any]:
    """Arrays whose new leading axis, where they have one, becomes a part of `axis`, and
    those without repeated along it."""

    def folded(x, has):
        x = x if has else jnp.broadcast_to(x, (size, *x.shape))
        x = jnp.moveaxis(x, 0, axis)
        return x.reshape(*x.shape[:axis], size * x.shape[axis + 1], *x.shape[axis + 2 :])

    return [folded(x, has) for x, has in zip(arrays, batched, strict=True)]


def _length(arrays: list[Any], batched: list[bool]) -> int:
    """Of the first axis of arrays, a new leading one not counted."""
    return arrays[0].shape[int(batched[0])]


def _nothing(shapes: PyTree) -> PyTree:
    """For each of no entries of a new leading axis."""
    return jax.tree.map(lambda s: jnp.zeros((0, *s.shape), s.dtype), shapes)


def _fewer(x: Any, size: int, axis: int) -> Any:
    """Undoes [`_more`][]: the part of `axis` is a leading axis again."""
    lead, count, rest = x.shape[:axis], x.shape[axis] // size, x.shape[axis + 1 :]
    return jnp.moveaxis(x.reshape(*lead, size, count, *rest), axis, 0)


def _with_integers(out: PyTree, tangent: list[Any]) -> PyTree:
    """The tangents as a tree like `out`; what is no real number has none."""
    leaves, tree = jax.tree.flatten(out)
    given = iter(tangent)
    filled = [
        next(given) if is_real(x) else np.zeros(x.shape, jax.dtypes.float0) for x in leaves
    ]
    return jax.tree.unflatten(tree, filled)
