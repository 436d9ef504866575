"""Many experiments at once: one function from a sample of parameters to an experiment, run
over batches of samples by one of two engines."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .._checks import divides
from ..experiment import Experiment, Record
from ..metrics import AbstractMetric
from .frontend.lower import NotFusible
from .fused.batch import Fused
from .fused.plan import Batch as Batch, Plan


class Runner:
    """A batch that is traced once, when it is made, compiled once, when it is first called,
    and called with any number of samples, chunk by chunk for instance.

    - `make(sample)`: the experiment of one sample;
    - `like`: one sample, a pytree of arrays or of their shapes and types;
    - `steps`, `metrics`, `record`, `every`, `engine`, `threads`: as in [`run_batch`][];
    - `block`: makes the engine `"scan"` run that many samples at a time, the last ones
      repeated up to a whole block. The same samples in the same place of a block give the
      same bits then, whatever the size of a chunk; those of `"fused"` always do.

    Called with samples, every leaf with a leading axis of length N, it returns a
    [`Batch`][]. `engine` tells which one it is, `shapes` what one sample gives: the leaves
    of a batch without that axis and, in the record, without that of time. Sent to another
    process, it is not traced again, but compiled there.

    **Raises:** as [`run_batch`][].
    """

    engine: str
    shapes: Batch

    def __init__(
        self,
        make: Callable[[PyTree], Experiment],
        like: PyTree,
        steps: int,
        *,
        metrics: Mapping[str, AbstractMetric] | None = None,
        record: Callable[[Record], PyTree] | None = None,
        every: int | None = None,
        engine: str = "auto",
        threads: int | None = None,
        block: int | None = None,
    ):
        every = steps if every is None else every
        divides(every, steps)
        if engine not in ("auto", "fused", "scan"):
            raise ValueError(
                f'Argument `engine` must be "auto", "fused" or "scan", but got {engine!r}.'
            )
        self.steps, self.every, self.block = steps, every, block
        self._plan = Plan(make, dict(metrics or {}), record)
        like = jax.tree.map(_shape, like)
        self._fused = None if engine == "scan" else self._traced(like, threads, engine)
        self.engine = "scan" if self._fused is None else "fused"
        if self._fused is None:
            state, kept = jax.eval_shape(self._plan.first, like)
            self.shapes = Batch(jax.eval_shape(self._plan.results, state), kept)
        else:
            self.shapes = Batch(self._fused.program.final, self._fused.program.record)

    def __getstate__(self) -> dict[str, Any]:
        """Without what it was traced from, whose classes may exist in this process only."""
        return vars(self) | ({} if self._fused is None else {"_plan": None})

    def _traced(self, like: PyTree, threads: int | None, engine: str) -> Fused | None:
        try:
            fused = Fused(self._plan, like, self.steps, self.every, threads)
            fused.program  # noqa: B018  traced now, and refused now if it cannot be compiled
            return fused
        except (NotFusible, ImportError) as error:
            if engine == "fused":
                raise
            # Of whoever called what made the runner, `run_batch` for one.
            warnings.warn(f'Running with engine="scan". {error}', stacklevel=4)
            return None

    def __call__(self, samples: PyTree) -> Batch:
        samples = jax.tree.map(_array, samples)
        lanes = _lanes(samples)
        if self._fused is not None:
            return self._fused(samples)
        if self.block is None:
            return _scanned(self._plan, samples, self.steps, self.every)
        return self._in_blocks(samples, lanes, self.block)

    def _in_blocks(self, samples: PyTree, lanes: int, block: int) -> Batch:
        padding = -lanes % block
        samples = jax.tree.map(
            lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], padding, axis=0)]), samples
        )
        pieces = [
            _scanned(
                self._plan,
                jax.tree.map(lambda x, k=k: x[k : k + block], samples),
                self.steps,
                self.every,
            )
            for k in range(0, lanes, block)
        ]
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:lanes], *pieces)


def run_batch(
    make: Callable[[PyTree], Experiment],
    samples: PyTree,
    steps: int,
    *,
    metrics: Mapping[str, AbstractMetric] | None = None,
    record: Callable[[Record], PyTree] | None = None,
    every: int | None = None,
    engine: str = "auto",
    threads: int | None = None,
) -> Batch:
    """Run `make(sample)` for `steps` samples in time, for every sample of a batch. For many
    batches of one kind use a [`Runner`][], which compiles once.

    - `samples`: a pytree, every leaf with a leading axis of length N; what `make` uses of
      it may be anything: parameters, initial states, keys of random numbers;
    - `metrics`: by name, each computed inside the loop;
    - `record(record)`: what to keep of every `every`-th record, by default only the last;
    - `engine`: `"fused"` compiles the whole loop to machine code (the extra `study`);
      `"scan"` is `jax.lax.scan` under `jax.vmap`; `"auto"` is the former, or the latter
      with a warning where the experiment cannot be compiled;
    - `threads`: of the fused engine, by default as many as there are processors.

    The results do not depend on the number of threads. Both engines run the same equations
    on the same random numbers, and agree to rounding.

    **Raises:** [`NotFusible`][] where `engine="fused"` meets what it cannot compile;
    `ValueError` for samples without a common leading axis, or `every` that does not divide
    `steps`.
    """
    samples = jax.tree.map(_array, samples)
    _lanes(samples)
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), samples)
    runner = Runner(
        make,
        like,
        steps,
        metrics=metrics,
        record=record,
        every=every,
        engine=engine,
        threads=threads,
    )
    return runner(samples)


def _array(x: Any) -> Any:
    return x if isinstance(x, np.ndarray | jax.Array) else jnp.asarray(x)


def _shape(x: Any) -> jax.ShapeDtypeStruct:
    x = x if isinstance(x, jax.ShapeDtypeStruct) else jnp.asarray(x)
    # In single precision where JAX is, as the samples will be.
    dtype = jax.dtypes.canonicalize_dtype(x.dtype, allow_extended_dtype=True)
    return jax.ShapeDtypeStruct(x.shape, dtype)


def _lanes(samples: PyTree) -> int:
    sizes = {leaf.shape[0] if leaf.ndim else -1 for leaf in jax.tree.leaves(samples)}
    if len(sizes) != 1 or -1 in sizes:
        raise ValueError(
            "Argument `samples` must have one leading axis of common length in every leaf, "
            f"but got the shapes {[leaf.shape for leaf in jax.tree.leaves(samples)]}."
        )
    return sizes.pop()


@eqx.filter_jit
def _scanned(plan: Plan, samples: PyTree, steps: int, every: int) -> Batch:
    def one(sample):
        state, first = plan.first(sample)
        prepared = plan.prepared(sample)

        def block(state, k):
            def quiet(j, state):
                return plan.step(k + j, state, sample, prepared)[0]

            state = jax.lax.fori_loop(0, every - 1, quiet, state)
            return plan.step(k + every - 1, state, sample, prepared)

        state, rest = jax.lax.scan(block, state, jnp.arange(0, steps, every))
        join = lambda a, b: jnp.concatenate([a[None], b])
        return Batch(plan.results(state), jax.tree.map(join, first, rest))

    return jax.vmap(one)(samples)
