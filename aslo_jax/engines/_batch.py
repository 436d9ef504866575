"""Many experiments at once: one function from a sample of parameters to an experiment, run
over batches of samples by one of two engines."""

from collections.abc import Callable, Mapping
from typing import Any, SupportsIndex

import equinox as eqx
import jax
import jax.numpy as jnp
import wadler_lindig as wl

from .. import _choices
from .._checks import (
    counted,
    divides,
    function,
    kind,
    one_of,
    told_apart,
    unlike,
    whole,
)
from .._continuous import AnyExperiment, ContinuousExperiment
from .._experiment import Record
from .._module import WIDTH
from .._typing import Engine, PyTree, RunningEngine
from ..metrics import AbstractMetric
from ..metrics._base import MakeMetric, metric_of_each
from ._adaptive.batch import Continuous, run_by_diffrax
from ._fused.batch import Fused
from ._fused.plan import Batch as Batch, Plan
from ._fused.refusal import notice, refusal
from ._samples import arrays, fitted, lanes_of, shape_of, words

COUNTED = 2**24  # steps that every precision counts


class Runner:
    """A batch that is traced once, when it is made, compiled once, when it is first called,
    and called with any number of samples, chunk by chunk for instance.

    - `make(sample)`: the experiment of one sample;
    - `like`: one sample, a pytree of arrays or of their shapes and types;
    - `steps`, `metrics`, `record`, `every`, `engine`, `threads`: as in [`run_batch`][];
    - `block`: makes the engine `"scan"` run that many samples at a time, the last ones
      repeated up to a whole block. The same samples in the same place of a block give the
      same bits then, whatever the size of a chunk; those of `"fused"` always do.

    Called with the parameters of N samples, as [`run_batch`][] takes them, it returns a
    [`Batch`][]. `engine` tells which one it is, `shapes` what one sample gives: the leaves
    of a batch without that axis and, in the record, without that of time. Sent to another
    process, it is not traced again, but compiled there; with the engine `"fused"` it has
    no derivatives there.

    Samples take the types of `like`; real numbers are rounded where those are shorter.

    **Raises:** as [`run_batch`][]; `ValueError` for samples of another structure or shape
    than `like`, or whole numbers that its types do not hold.
    """

    engine: RunningEngine
    steps: int
    every: int
    block: int | None
    shapes: Batch

    def __init__(
        self,
        make: Callable[[PyTree], AnyExperiment],
        like: PyTree,
        steps: SupportsIndex,
        *,
        metrics: Mapping[str, MakeMetric] | None = None,
        record: Callable[[Record[Any]], PyTree] | None = None,
        every: SupportsIndex | None = None,
        engine: Engine = "auto",
        threads: SupportsIndex | None = None,
        block: SupportsIndex | None = None,
    ) -> None:
        steps = counted("steps", steps)
        every = steps if every is None else counted("every", every)
        divides(every, steps)
        if threads is not None:
            threads = counted("threads", threads)
            whole("threads", threads)
        if block is not None:
            block = counted("block", block)
            whole("block", block)
        one_of("engine", engine, _choices.Engine)
        if not callable(make):
            raise unlike("make", make, "a function from a sample to an experiment")
        function("record", record)
        kind("metrics", metrics, Mapping, hint="metrics by name, a dictionary")
        self.steps, self.every, self.block = steps, every, block
        self._like = like = jax.tree.map(shape_of, words(like))
        self._continuous = _is_continuous(make, like)
        if steps > COUNTED:
            interval = jax.eval_shape(lambda x: getattr(make(x), "interval", None), like)
            if interval is not None:  # what has none keeps no time
                told_apart(steps, interval)
        self._plan = Plan(make, _metrics(make, like, metrics or {}), record)
        self._fused, self._may_scan = None, engine == "auto"
        if engine != "scan":
            self._fused = self._traced(threads)
        self.engine = "scan" if self._fused is None else "fused"
        if self._fused is None:
            if self._continuous:
                self.shapes = self._shapes_by_diffrax()
            else:
                state, kept = jax.eval_shape(self._plan.first, like)
                self.shapes = Batch(jax.eval_shape(self._plan.results, state), kept)
        elif isinstance(self._fused, Continuous):
            final, record = self._fused.program.final, self._fused.program.record
            self.shapes = Batch(final[0], record)
        else:
            self.shapes = Batch(self._fused.program.final, self._fused.program.record)

    def __repr__(self) -> str:
        """What it runs, and on what; not how."""
        like = wl.pformat(self._like, width=WIDTH, short_arrays=True, custom=_shape)
        parts = [f"like={like}", f"steps={self.steps}"]
        parts += [f"metrics={sorted(self.shapes.metrics)}"] if self.shapes.metrics else []
        parts += [f"every={self.every}"] if self.every != self.steps else []
        return f"Runner({', '.join(parts)}, engine={self.engine!r})"

    def __getstate__(self) -> dict[str, Any]:
        """Without what it was traced from, whose classes may exist in this process only."""
        return vars(self) | ({} if self._fused is None else {"_plan": None})

    def _traced(self, threads: int | None) -> Fused | Continuous | None:
        """With what refuses to be traced refused now, or left to the other engine."""
        otherwise = self._resort if self._may_scan else None
        given = self._plan, self._like, self.steps, self.every, threads
        if self._continuous:
            fused: Fused | Continuous = Continuous(*given)
        else:
            fused = Fused(*given, otherwise)
        try:
            fused.program  # noqa: B018
            return fused
        except Exception as error:
            failure = error
        self._check()
        refused = refusal(failure)
        if not self._may_scan:
            raise refused
        notice(f'Running with engine="scan". {refused}')
        return None

    def _check(self) -> None:
        """Raises what the engine `"scan"` would: errors of the experiment itself."""
        one = lambda s: jax.ShapeDtypeStruct((1, *s.shape), s.dtype)
        samples = jax.tree.map(one, self._like)
        eqx.filter_eval_shape(self._run, self._plan, samples, self.steps, self.every)

    def _shapes_by_diffrax(self) -> Batch:
        one = lambda s: jax.ShapeDtypeStruct((1, *s.shape), s.dtype)
        samples = jax.tree.map(one, self._like)
        given = self._plan, samples, self.steps, self.every
        found = eqx.filter_eval_shape(_by_diffrax, *given)
        drop = lambda n: lambda s: jax.ShapeDtypeStruct(s.shape[n:], s.dtype)
        metrics, record = found.metrics, found.record
        return Batch(jax.tree.map(drop(1), metrics), jax.tree.map(drop(2), record))

    @property
    def _run(self) -> Callable[..., Batch]:
        """Of the engine `"scan"`."""
        return _by_diffrax if self._continuous else _scanned

    def __call__(self, parameters: PyTree) -> Batch:
        samples = fitted(arrays(parameters), self._like)
        if self._fused is not None:
            return self._fused(samples)
        return self._scanned(samples)

    def _resort(self, error: Exception, samples: PyTree) -> Batch:
        """Of the engine `"scan"`, where the other has failed to compile what it traced."""
        found = self._scanned(samples)
        self.engine, self._fused = "scan", None
        notice(f'Running with engine="scan". {refusal(error)}')
        return found

    def _scanned(self, samples: PyTree) -> Batch:
        lanes = lanes_of(samples)
        if self.block is None or not lanes:
            return self._run(self._plan, samples, self.steps, self.every)
        return self._in_blocks(samples, lanes, self.block)

    def _in_blocks(self, samples: PyTree, lanes: int, block: int) -> Batch:
        padding = -lanes % block
        samples = jax.tree.map(
            lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], padding, axis=0)]), samples
        )
        pieces = [
            self._run(
                self._plan,
                jax.tree.map(lambda x, k=k: x[k : k + block], samples),
                self.steps,
                self.every,
            )
            for k in range(0, lanes, block)
        ]
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:lanes], *pieces)


def run_batch(
    make: Callable[[PyTree], AnyExperiment],
    parameters: PyTree,
    steps: SupportsIndex,
    *,
    metrics: Mapping[str, MakeMetric] | None = None,
    record: Callable[[Record[Any]], PyTree] | None = None,
    every: SupportsIndex | None = None,
    engine: Engine = "auto",
    threads: SupportsIndex | None = None,
) -> Batch:
    """Run `make(sample)` for `steps` intervals, for every sample of a batch. For many
    batches of one kind use a [`Runner`][], which compiles once.

    - `parameters`: those of the N samples, a pytree with a leading axis of length N in
      every leaf; what `make` uses of it may be anything: gains, initial states, keys of
      random numbers (`make` is given the two words of a key);
    - `metrics`: by name, each computed inside the loop: an instance, of the observer that
      it names, or a class of `aslo_jax.metrics`, or any `metric(observer)`, of every
      observer, whose results are by observer then;
    - `record(record)`: what to keep of every `every`-th record, by default only the last;
    - `engine`: `"fused"` compiles the whole loop to machine code (the extra `study`);
      `"scan"` is `jax.lax.scan` under `jax.vmap`; `"auto"` is the former, or the latter
      with a warning where the experiment cannot be compiled;
    - `threads`: of the fused engine, by default as many as there are processors.

    Ctrl-C ends a fused run within a fraction of a second; under `jax.jit`, JAX reports it
    as an error of the callback. Derivatives of the fused engine are forward ones of the
    first order (`jax.jvp`, `jax.jacfwd`).

    The results do not depend on the number of threads. Both engines run the same equations
    on the same random numbers, and agree to rounding.

    **Raises:** [`NotFusible`][] where `engine="fused"` meets what it cannot compile;
    `ValueError` for samples without a common leading axis, `every` that does not divide
    `steps`, or what is no whole number; `NotImplementedError` for other derivatives of the
    fused engine. An experiment's own errors are raised as they are.
    """
    samples = arrays(parameters)
    lanes_of(samples)
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


def _metrics(
    make: Callable[[PyTree], AnyExperiment],
    like: PyTree,
    metrics: Mapping[str, MakeMetric],
) -> dict[str, AbstractMetric]:
    """The metrics to run, with one for each observer of what makes them."""
    observers: list[str] = []
    if not all(isinstance(metric, AbstractMetric) for metric in metrics.values()):
        made = eqx.filter_eval_shape(make, like)
        observers = list(getattr(made, "observers", ()))  # a loop of one's own has none
    return {name: metric_of_each(metric, observers) for name, metric in metrics.items()}


def _shape(x: Any) -> wl.AbstractDoc | None:
    """A shape and type, as arrays are abbreviated."""
    if not isinstance(x, jax.ShapeDtypeStruct):
        return None
    return wl.array_summary(x.shape, f"{x.dtype}", kind=None)


def _is_continuous(make: Any, like: PyTree) -> bool:
    made = eqx.filter_eval_shape(make, like)
    return isinstance(made, ContinuousExperiment)


_by_diffrax = eqx.filter_jit(run_by_diffrax)


@eqx.filter_jit
def _scanned(plan: Plan, samples: PyTree, steps: int, every: int) -> Batch:
    def one(sample):
        state, first, prepared = plan.begun(sample)

        def block(state, k):
            def quiet(j, state):
                return plan.step(k + j, state, sample, prepared)[0]

            state = jax.lax.fori_loop(0, every - 1, quiet, state)
            return plan.step(k + every - 1, state, sample, prepared)

        state, rest = jax.lax.scan(block, state, jnp.arange(0, steps, every))
        join = lambda a, b: jnp.concatenate([jnp.asarray(a)[None], b])
        return Batch(plan.results(state), jax.tree.map(join, first, rest))

    return jax.vmap(one)(samples)
