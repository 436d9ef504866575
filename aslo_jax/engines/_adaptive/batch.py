"""Batches of continuous experiments: every lane of a fused loop, or every run of diffrax,
with metrics and records at even instants."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._checks import is_concrete
from ..._continuous import Beside, recorded
from ..._frontend.outlining import ALWAYS
from ..._typing import PyTree
from .._fused.plan import Batch, Plan
from .._fused.program import Program
from .._runtime.host import widths
from .alike import traced
from .marching import March
from .pairs import pair_for
from .program import Bodies, adaptive
from .simulation import warn
from .stepper import ENDED, Dense, Stepper


class Saving(NamedTuple):
    """The next row, and the states of the metrics."""

    row: Any
    metrics: PyTree


def _integrands(plan: Plan, record: Any) -> dict[str, PyTree]:
    """Of the metrics that are integrals."""
    found = {name: m.integrand(record) for name, m in plan.metrics.items()}
    return {name: rate for name, rate in found.items() if rate is not None}


class Continuous:
    """A batch of one plan, `like` the shapes of one of its samples, over so many intervals,
    of which every `every`-th is recorded. Called with samples, it runs."""

    def __init__(
        self, plan: Plan, like: PyTree, steps: int, every: int, threads: int | None
    ) -> None:
        self.plan, self.steps, self.every, self.threads = plan, steps, every, threads
        self.sample, self.tree = jax.tree.flatten(like)
        made: Any = eqx.filter_eval_shape(plan.make, like)
        self.max_steps, self.pair = made.max_steps, pair_for(made.rtol)

    def __getstate__(self) -> dict[str, Any]:
        """What runs."""
        self.program  # noqa: B018  traced here
        return vars(self) | {"plan": None}

    @functools.cached_property
    def program(self) -> Program:
        """Traced when it is first asked for, and compiled when first called."""
        return adaptive(self._bodies(), {"lane": self.sample}, widths()[:1])

    def __call__(self, samples: PyTree) -> Batch:
        leaves = jax.tree.leaves(samples)
        if not is_concrete(*leaves):
            raise NotImplementedError(
                "The fused engine has no derivatives in continuous time, and runs outside "
                'of `jax.jit`; use engine="scan".'
            )
        leaves = [np.asarray(x) for x in leaves]
        rows = self.steps // self.every + 1
        record, (metrics, code, stiff) = self.program(
            {"lane": leaves},
            len(leaves[0]),
            self.max_steps,
            threads=self.threads,
            rows=rows,
        )
        warn(code, stiff)
        return jax.tree.map(jnp.asarray, Batch(metrics, record))

    def _bodies(self) -> Bodies:
        plan, steps, every = self.plan, self.steps, self.every

        def experiment(inputs) -> Any:
            return plan.make(jax.tree.unflatten(self.tree, inputs["lane"]))

        integrands = functools.partial(_integrands, plan)

        def start(inputs):
            loop, x0 = experiment(inputs).begun(steps)
            zero = jnp.zeros((), jnp.result_type(float))
            return Beside(loop, integrands).init(zero, x0)

        def field(inputs, t, both):
            return Beside(experiment(inputs).begun(steps)[0], integrands).rate(t, both)

        def reduced(integrals):
            return [(n, m) for n, m in plan.metrics.items() if n not in integrals]

        states = traced(start, field)

        def of(inputs, step=False):
            made = experiment(inputs)
            loop, _ = made.begun(steps)
            alike = states(inputs)
            x, tree = alike.start(inputs), alike.tree
            rate = alike.field_at(inputs, self.pair.main if step else ALWAYS)
            jumps = np.empty(0) if loop.span is None else loop.span.jumps
            stepper = Stepper(self.pair, made.rtol, made.atol, jumps.size > 0)
            ends = (np.asarray(t, x.dtype) for t in (0.0, steps * made.interval))
            march = March(stepper, jumps, *ends)
            return made, loop, x, tree, rate, stepper, march

        def begin(inputs):
            _, loop, x, tree, rate, _, march = of(inputs)
            record = recorded(loop, jnp.zeros((), x.dtype), tree(x)[0])
            metrics = {name: m.init(record) for name, m in reduced(integrands(record))}
            return march.begin(rate, x), Saving(jnp.asarray(1), metrics), None

        def first(inputs):
            _, loop, x, tree, *_ = of(inputs)
            return plan._kept(recorded(loop, jnp.zeros((), x.dtype), tree(x)[0]))

        def advance(carry, inputs, _):
            *_, rate, _, march = of(inputs, step=True)
            return march.step(rate, carry)

        def save(saving, dense, inputs, _):
            made, loop, _, tree, rate, stepper, _ = of(inputs)
            dense = stepper.prepared(rate, Dense(*dense))
            last = saving.row >= steps
            t = jnp.where(last, steps * made.interval, saving.row * made.interval)
            due = dense.accepted & (saving.row <= steps) & (t <= dense.end)
            record = recorded(loop, t, tree(stepper.at(dense, t))[0])
            metrics = {
                name: plan.metrics[name].update(metric, record)
                for name, metric in saving.metrics.items()
            }
            after = Saving(saving.row + 1, metrics)
            written = saving.row % every == 0
            return due, written, saving.row // every, after, plan._kept(record)

        def finish(carry, saving, inputs):
            made, _, _, tree, rate, stepper, _ = of(inputs)
            code = carry.lane.code
            end = jnp.asarray(steps * made.interval, carry.lane.t.dtype)
            stiff = stepper.stiff(rate, carry.lane, end)
            results = _results(plan, saving.metrics, tree(carry.lane.x)[1])
            there = code == ENDED
            return jax.tree.map(lambda x: _unless(there, x), results), code, stiff

        return Bodies(begin, advance, finish, save, first)


def _results(plan: Plan, metrics: PyTree, integrals: PyTree) -> dict[str, PyTree]:
    """Of the metrics, from their last states and from what has been integrated."""
    found = {}
    for name, metric in plan.metrics.items():
        if name in integrals:
            found[name] = metric.result(metric.of_integral(integrals[name]))
        else:
            found[name] = metric.result(metrics[name])
    return found


def _unless(there: Any, x: Any) -> Any:
    """A metric, which a run that does not reach its end has not."""
    return jnp.where(there, x, jnp.nan) if jnp.issubdtype(x.dtype, jnp.floating) else x


def run_by_diffrax(plan: Plan, samples: PyTree, steps: int, every: int) -> Batch:
    """The same by diffrax, vectorised."""

    def one(sample):
        records, integrals = plan.make(sample).integrated(
            steps, functools.partial(_integrands, plan)
        )
        row = lambda k: jax.tree.map(lambda x: x[k], records)
        others = {n: m for n, m in plan.metrics.items() if n not in integrals}
        metrics = {name: m.init(row(0)) for name, m in others.items()}

        def update(states, record):
            return {n: m.update(states[n], record) for n, m in others.items()}, None

        rest = jax.tree.map(lambda x: x[1:], records)
        metrics, _ = jax.lax.scan(update, metrics, rest)
        kept = jax.tree.map(lambda x: x[::every], records)
        kept = None if plan.record is None else jax.vmap(plan.record)(kept)
        last = jax.tree.map(lambda x: x[-1], integrals)
        return Batch(_results(plan, metrics, last), kept)

    return jax.vmap(one)(samples)
