"""Many experiments at once: one function from a sample of parameters to an experiment, run
over a batch of samples by one of two engines."""

import warnings
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from ..experiment import Experiment, Record
from ..metrics import AbstractMetric
from .flatten import NotFusible
from .fused import Fused
from .plan import Batch as Batch, Plan


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
    """Run `make(sample)` for `steps` samples in time, for every sample of a batch.

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
    every = steps if every is None else every
    if steps < 1 or every < 1 or steps % every:
        raise ValueError(
            "Argument `every` must divide `steps`, both at least 1, but got "
            f"steps = {steps}, every = {every}."
        )
    if engine not in ("auto", "fused", "scan"):
        raise ValueError(
            f'Argument `engine` must be "auto", "fused" or "scan", but got {engine!r}.'
        )
    samples = jax.tree.map(jnp.asarray, samples)
    _lanes(samples)
    plan = Plan(make, dict(metrics or {}), record)
    if engine == "scan":
        return _scanned(plan, samples, steps, every)
    try:
        like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), samples)
        return Fused(plan, like, steps, every, threads)(samples)
    except (NotFusible, ImportError) as error:
        if engine == "fused":
            raise
        warnings.warn(f'Running with engine="scan". {error}', stacklevel=2)
        return _scanned(plan, samples, steps, every)


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
