"""Continuous co-simulation by the fused engine: one run, or many beside each other."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._checks import is_concrete
from ..._frontend.outlining import ALWAYS
from ..._typing import PyTree
from .._fused.forward_only import forward_only, second
from .._fused.kept import kept, key_of, shape_of
from .._fused.program import Program
from .._fused.refusal import notice
from .._runtime.host import widths
from .alike import States, traced
from .derivatives import beside_tangents, rates_of, tangents_of
from .marching import March
from .pairs import pair_for
from .program import Bodies, adaptive
from .stepper import DIVERGED, ENDED, RUNNING, Dense, Field, Stepper
from .system import System


class Plan(NamedTuple):
    """How: from t0 to t1 (s), with a tolerance of errors `atol + rtol |x|`, |x| the largest
    value of that state up to now; rows at the instants `ts`, shape `(N,)`; no step over one
    of the `jumps`, ascending (s)."""

    t0: float
    t1: float
    ts: np.ndarray
    jumps: np.ndarray
    rtol: float
    atol: float
    max_steps: int
    threads: int | None = None

    @property
    def inner(self) -> np.ndarray:
        """The instants before t1, whose rows are interpolated."""
        return self.ts[self.ts < self.t1]

    @property
    def key(self) -> tuple[Any, ...]:
        bytes_of = self.ts.tobytes(), self.jumps.tobytes(), str(self.ts.dtype)
        return self.t0, self.t1, *bytes_of, self.rtol, self.atol


class Outcome(NamedTuple):
    """How a lane ended: its `code`, how many steps were accepted and rejected, and whether
    their length was bounded by stability at the end."""

    code: Any
    accepted: Any
    rejected: Any
    stiff: Any


def bodies(system: System, plan: Plan) -> Bodies:
    """The loop of a system, as functions of the arrays of a lane."""
    pair, dtype, ts = pair_for(plan.rtol), plan.ts.dtype, plan.inner
    stepper = Stepper(pair, plan.rtol, plan.atol, plan.jumps.size > 0)
    ends = (np.asarray(t, dtype) for t in (plan.t0, plan.t1))
    march = March(stepper, plan.jumps, *ends)

    states = traced(system.init, system.rate)
    row = jax.jit(system.record)  # of which JAX keeps the trace

    def of(arrays: PyTree, times: int = ALWAYS) -> tuple[States, Field]:
        alike = states(arrays)
        return alike, alike.field_at(arrays, times)

    def begin(inputs):
        alike, rate = of(inputs["lane"])
        first = jnp.asarray(0, jnp.int64 if _wide() else jnp.int32)
        return (
            march.begin(rate, alike.start(inputs["lane"])),
            first if len(ts) else None,
            None,
        )

    def advance(carry, inputs, _):
        return march.step(of(inputs["lane"], pair.main)[1], carry)

    def save(number, dense, inputs, _):
        alike, rate = of(inputs["lane"])
        dense = stepper.prepared(rate, Dense(*dense))
        t = jnp.asarray(ts)[jnp.minimum(number, len(ts) - 1)]
        due = dense.accepted & (number < len(ts)) & (t <= dense.end)
        columns = row(inputs["lane"], t, alike.tree(stepper.at(dense, t)))
        return due, jnp.asarray(True), number, number + 1, columns

    def finish(carry, _, inputs):
        lane = carry.lane
        alike, rate = of(inputs["lane"])
        stiff = stepper.stiff(rate, lane, jnp.asarray(march.t1))
        outcome = Outcome(lane.code, lane.accepted, lane.rejected, stiff)
        if len(ts) == len(plan.ts):
            return outcome, None
        return outcome, row(inputs["lane"], jnp.asarray(march.t1), alike.tree(lane.x))

    return Bodies(begin, advance, finish, save if len(ts) else None)


def _wide() -> bool:
    return jnp.result_type(float) == jnp.float64


class Simulation:
    """A system whose parts that are no arrays are given, run for arrays with any axes in
    front."""

    def __init__(
        self, system: System, plan: Plan, key: Any, tree: Any, ranks: list[int]
    ) -> None:
        self.system, self.plan, self.key = system, plan, key
        self.tree, self.ranks = tree, ranks
        self._program: Program | None = None

    def shapes(self, leaves: list[Any]) -> Any:
        rows, program = len(self.plan.ts), self.program(leaves)
        row = program.final[1] if program.record is None else program.record
        whole = lambda s: jax.ShapeDtypeStruct((rows, *s.shape), s.dtype)
        dtype = self.plan.ts.dtype
        number = jax.ShapeDtypeStruct((), dtype)
        code = jax.ShapeDtypeStruct((), np.dtype(np.int32))
        flag = jax.ShapeDtypeStruct((), np.dtype(bool))
        return jax.tree.map(whole, row), Outcome(code, number, number, flag)

    def __call__(self, leaves: list[Any]) -> Any:
        leaves = [np.asarray(x) for x in leaves]
        lead = leaves[0].shape[: leaves[0].ndim - self.ranks[0]]
        lanes = int(np.prod(lead, dtype=int))
        flat = [x.reshape(lanes, *x.shape[len(lead) :]) for x in leaves]
        program = self.program([shape_of(x, 1) for x in flat])
        rows = len(self.plan.ts)
        record, (final, last) = program(
            {"lane": flat}, lanes, self.plan.max_steps, threads=self.plan.threads, rows=rows
        )
        if last is not None:
            record = _with_last(record, last, final.code == ENDED)
        warn(final.code, final.stiff)
        back = lambda x: x.reshape((*lead, *x.shape[1:]))
        return jax.tree.map(back, (record, final))

    def program(self, shapes: list[jax.ShapeDtypeStruct]) -> Program:
        """For arrays of some shapes, traced and compiled once."""
        if self._program is not None:
            return self._program
        given = {"lane": shapes}
        make = lambda: adaptive(self._bodies(), given, widths()[:1])
        static = jax.tree.map(_hashable, self.key)
        program = kept(key_of(static, given, self.tree, *self.plan.key), make)
        program.compile()
        self._program = program
        return program

    def _bodies(self) -> Bodies:
        arrays = lambda leaves: jax.tree.unflatten(self.tree, leaves)
        system = System(
            lambda leaves: self.system.init(arrays(leaves)),
            lambda leaves, t, state: self.system.rate(arrays(leaves), t, state),
            lambda leaves, t, state: self.system.record(arrays(leaves), t, state),
        )
        return bodies(system, self.plan)


def _with_last(record: PyTree, last: PyTree, reached: np.ndarray) -> PyTree:
    """Rows whose last one is that of the end, for the lanes that have reached it."""

    everywhere = reached.all()

    def there(row: np.ndarray) -> np.ndarray:
        if everywhere:
            return row
        blank = np.asarray(np.nan if row.dtype.kind == "f" else 0, row.dtype)
        return np.where(reached.reshape(-1, *(1,) * (row.ndim - 1)), row, blank)

    def put(rows: np.ndarray, row: np.ndarray) -> np.ndarray:
        rows[:, -1] = there(row)
        return rows

    if record is None:
        return jax.tree.map(lambda row: there(row)[:, None], last)
    return jax.tree.map(put, record, last)


def _hashable(x: Any) -> Any:
    return (x.shape, x.dtype.str, x.tobytes()) if isinstance(x, np.ndarray) else x


def warn(code: np.ndarray, stiff: np.ndarray) -> None:
    """Says how many runs did not reach their end, and why, and how many are stiff."""
    stuck, many = int((code == DIVERGED).sum()), int((code == RUNNING).sum())
    reasons = []
    if stuck:
        reasons.append(f"{stuck} diverged, or became too steep for any step")
    if many:
        reasons.append(f"{many} took all of their `max_steps` steps")
    if reasons:
        notice(
            f"Of {code.size} runs {' and '.join(reasons)}: what they have saved since is "
            "NaN. A stiff system needs an implicit solver of diffrax."
        )
    if stiff.any():
        notice(
            f"Of {code.size} runs {int(stiff.sum())} took steps as short as stability "
            "wants them, not accuracy: the system is stiff. It may take far less time with "
            "an implicit solver, `solver=diffrax.Kvaerno5()`."
        )


def simulated(
    system: System, arrays: PyTree, static: PyTree, plan: Plan, order: int = 0
) -> Any:
    """The rows, with a leading axis of the instants, and the outcome of a system. Under
    `jax.vmap` the systems of a batch run beside each other. It has forward derivatives of
    the first order; the system given is one of that `order`."""
    leaves, tree = jax.tree.flatten(arrays)
    ranks = [np.ndim(x) for x in leaves]
    run = Simulation(system, plan, (static, order), tree, ranks)
    if is_concrete(*leaves):
        return jax.device_put(run([np.asarray(x) for x in leaves]))

    @jax.custom_jvp
    def called(leaves):
        given = [jax.ShapeDtypeStruct(jnp.shape(x), x.dtype) for x in leaves]
        run.program(given)
        shapes = run.shapes(given)
        return jax.pure_callback(run, shapes, leaves, vmap_method="broadcast_all")

    @called.defjvp
    def pushed(primals, tangents):
        if order:
            second(primals, tangents)
        (leaves,), (rates,) = primals, tangents
        rates = rates_of(leaves, rates)
        rates = [None if r is None else forward_only(r) for r in rates]
        given = tuple(jax.tree.unflatten(tree, each) for each in (leaves, rates))
        # Values are those of a run of their own: they do not depend on the direction.
        row, outcome = called(leaves)
        (_, rate), _ = simulated(beside_tangents(system), given, static, plan, 1)
        return (row, outcome), tangents_of(row, outcome, rate)

    return called(leaves)
