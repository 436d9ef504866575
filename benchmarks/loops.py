"""How a closed loop is run: by the engines of the library, by diffrax around its modules,
by SciPy on its vector field, and accurately."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.observers import ObserverState

PRECISE = diffrax.PIDController(rtol=1e-12, atol=1e-14)


class Work(NamedTuple):
    """A closed loop that every engine runs.

    - `make(sample, **choice)`: the experiment of a sample;
    - `samples(count)`: samples with a leading axis;
    - `keep(record)`: what is compared, the true hidden part first, then one row for each
      observer, shape `(1 + observers, n)`;
    - `interval` (s).
    """

    make: Callable[..., aslo.Experiment]
    samples: Callable[[int], Any]
    keep: Callable[[Any], Any]
    interval: float


class Sampled:
    """A function without arguments, traced now and compiled in its first call: what is kept
    of the last sample."""

    def __init__(
        self,
        work: Work,
        engine: Literal["auto", "fused", "scan"],
        batch,
        steps: int,
        threads=None,
        target=None,
        **choice,
    ):
        """For a target of the fused engine, or for this host."""
        from aslo_jax.engines import Runner

        self.batch = batch
        self.runner = Runner(
            lambda sample: work.make(sample, **choice),
            jax.tree.map(lambda x: x[0], batch),
            steps,
            record=work.keep,
            every=steps,
            engine=engine,
            threads=threads,
        )
        if target is not None:
            program = self.program
            program.target, program.widths = target, target.widths

    def __call__(self) -> np.ndarray:
        return np.asarray(self.runner(self.batch).record)[:, -1]

    @property
    def operations(self) -> int:
        """Of one step of one trajectory in the graph of the fused engine, a product with a
        sum counted as two."""
        return self.program.operations

    @property
    def step(self) -> Any:
        """Of the kernel."""
        return self.program._step

    @property
    def program(self) -> Any:
        """The one place that looks inside the engine."""
        fused = self.runner._fused
        assert fused is not None, "no other engine has a program"
        return fused.program


def exact(work: Work, batch, steps: int, **choice: Any):
    """The end of the sampled loop, as a plain loop around an accurate plant: diffrax's
    Dopri8 at 1e-12 over every interval, with the input held."""

    def one(sample):
        loop = work.make(sample, **choice)
        plant, control, h = loop.plant, loop.controller, loop.interval
        feedback = loop.feedback or (lambda y, x, estimates: y)
        begun, first = loop.init()

        def step(state, k):
            x, u, inner, observers = state
            field = diffrax.ODETerm(lambda t, x, u: plant.vector_field(k * h + t, x, u))
            solution = diffrax.diffeqsolve(
                field,
                diffrax.Dopri8(),
                0.0,
                h,
                h,
                x,
                args=u,
                stepsize_controller=PRECISE,
                adjoint=diffrax.ForwardMode(),
            )
            x = jax.tree.map(lambda x: x[-1], solution.ys)
            t = (k + 1) * h
            y = plant.output(x)
            y = y if loop.sensor is None else loop.sensor(t, None, y)
            pairs = {n: o.step(observers[n], u, y, h) for n, o in loop.observers.items()}
            observers = {n: p[0] for n, p in pairs.items()}
            estimates = {n: p[1] for n, p in pairs.items()}
            fed = feedback(y, x, estimates)
            u, rate = control(t, inner, fed), control.vector_field(t, inner, fed)
            inner = jax.tree.map(lambda s, r: s + h * r, inner, rate)
            record = type(first)(t, x, plant.hidden(x), y, u, estimates)
            return (x, u, inner, observers), work.keep(record)

        state = begun.x, begun.command, begun.controller, begun.observers
        return jax.lax.scan(step, state, jnp.arange(steps))[1][-1]

    return jax.jit(jax.vmap(one))(batch)


def continuous(work: Work, batch, steps: int, solver=None, tolerance: float | None = None):
    """The same for the loop in continuous time, by diffrax: with fixed steps of the
    interval, or with adaptive ones of a relative `tolerance`."""
    end = steps * work.interval
    if tolerance is None:
        control, dt0 = diffrax.ConstantStepSize(), work.interval
    else:
        control, dt0 = diffrax.PIDController(tolerance, 1e-3 * tolerance), None

    @jax.jit
    @jax.vmap
    def compiled(sample):
        loop = work.make(sample)
        out = aslo.simulate(
            loop.plant,
            loop.controller,
            loop.observers,
            t1=end,
            ts=jnp.array([end]),
            initial=loop.initial,
            feedback=loop.feedback,
            solver=diffrax.Tsit5() if solver is None else solver,
            stepsize_controller=control,
            dt0=dt0,
        )
        return work.keep(jax.tree.map(lambda x: x[0], out))

    return lambda: jax.block_until_ready(compiled(batch))


def solve_ivp(work: Work, batch, steps: int, method: str, tolerance: float):
    """The loop in continuous time by SciPy, one trajectory after another; the vector field
    of the modules, compiled."""
    import scipy.integrate
    from jax.flatten_util import ravel_pytree

    end = steps * work.interval

    def parts(sample, state):
        loop = work.make(sample)
        x, *_ = state
        y = loop.plant.output(x)
        fed = y if loop.feedback is None else loop.feedback(y, x, {})
        return loop, y, fed

    def first(sample):
        begun, _ = work.make(sample).init()
        return begun.x, begun.controller, {n: s.states for n, s in begun.observers.items()}

    one = jax.tree.map(lambda x: x[0], batch)
    _, tree = ravel_pytree(first(one))

    @jax.jit
    def rates(t, flat, sample):
        x, inner, observers = state = tree(flat)
        loop, y, fed = parts(sample, state)
        u = loop.controller(t, inner, fed)
        rate = {
            n: o.vector_field(t, ObserverState(observers[n], y), u, y).states
            for n, o in loop.observers.items()
        }
        driven = loop.plant.vector_field(t, x, u)
        return ravel_pytree((driven, loop.controller.vector_field(t, inner, fed), rate))[0]

    @jax.jit
    def kept(flat, sample):
        x, inner, observers = state = tree(flat)
        loop, y, fed = parts(sample, state)
        t = jnp.asarray(end)
        u = loop.controller(t, inner, fed)
        estimates = {
            n: o.estimate(t, ObserverState(observers[n], y), u, y)
            for n, o in loop.observers.items()
        }
        record = type(loop.init()[1])(t, x, loop.plant.hidden(x), y, u, estimates)
        return work.keep(record)

    def trajectory(sample):
        found = scipy.integrate.solve_ivp(
            lambda t, x: np.asarray(rates(t, x, sample)),
            (0.0, end),
            np.asarray(ravel_pytree(first(sample))[0]),
            method=method,
            t_eval=[end],
            rtol=tolerance,
            atol=1e-3 * tolerance,
        )
        return kept(found.y[:, -1], sample)

    count = len(jax.tree.leaves(batch)[0])
    each = [jax.tree.map(lambda x, k=k: x[k], batch) for k in range(count)]
    return lambda: np.stack([trajectory(sample) for sample in each])
