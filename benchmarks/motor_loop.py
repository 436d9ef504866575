"""The work of the benchmark `pmsm`: a PMSM under field-oriented control by its measured
angle, its flux observed by the ASLO and the A-ASLO, its resistance and its magnet flux
another in each trajectory. The same modules for every engine of the library."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise

INTERVAL = 1e-4  # s
RATE, GAIN, THRESHOLD = 30.0, 20.0, 1e-4  # rad/s of F, rad/s of the A-ASLO, the guard's
CURRENT_LIMIT, VOLTAGE_LIMIT = 2.3, 300.0  # A, V
LOAD, NOISE = 0.5, 10e-3  # N m; A, standard deviation of a sample


def load(t):
    return jnp.full_like(t, LOAD)


def reference(t):
    """The speed (mechanical rad/s) to follow."""
    return 20.0 + 5.0 * jnp.sin(t)


MOTOR = aslo.plants.PMSM.bmp0701f(load=load)


def measured(y, x, estimates):
    return MotorFeedback(y, MOTOR.pole_pairs * x.angle, x.speed)


def motor(sample) -> Any:
    resistance, magnet_flux, _ = sample
    where = lambda m: (m.resistance, m.magnet_flux)
    return eqx.tree_at(where, MOTOR, (resistance, magnet_flux))


def controller() -> FieldOriented:
    return FieldOriented(MOTOR, reference, CURRENT_LIMIT, VOLTAGE_LIMIT)


def observers(
    paper: bool = False, count: int | None = None, gains: Any = (RATE, GAIN)
) -> dict[str, aslo.AbstractObserver]:
    """The ASLO and the A-ASLO, as printed if `paper`; or `count` ASLO of other filters."""
    relation, guard = MOTOR.flux_relation(), aslo.Guard(THRESHOLD)

    def algebraic(rate):
        law = aslo.LowPass(rate)
        if paper:
            return aslo.AlgebraicObserver(relation, law, aslo.Repeat(), guard, "paper")
        return aslo.AlgebraicObserver(relation, law, guard=guard)

    if count is not None:
        return {f"ASLO {k}": algebraic((1.0 + 0.1 * k) * RATE) for k in range(count)}
    rate, gain = gains
    one = algebraic(rate)
    return {"ASLO": one, "A-ASLO": aslo.Asymptotic(one, gain)}


def make(sample, noisy: bool = False, **choice: Any) -> aslo.Experiment:
    """The sampled closed loop of one sample."""
    sensor = SampledNoise(NOISE, INTERVAL, sample[2]) if noisy else None
    return aslo.Experiment(
        motor(sample),
        controller(),
        observers(**choice),
        INTERVAL,
        feedback=measured,
        sensor=sensor,
    )


def keep(record):
    """True flux and estimates, each of shape `(2,)`, one below the other."""
    names = sorted(record.estimates, key=lambda name: (len(name), name))
    return jnp.stack([record.hidden, *(record.estimates[name].value for name in names)])


def samples(count: int):
    """Resistance (ohm), magnet flux (Wb) and key of each trajectory."""
    rng = np.random.default_rng(7)
    keys = jax.vmap(aslo.random.fold, (None, 0))(aslo.random.key(3), jnp.arange(count))
    resistance = 8.875 * rng.uniform(0.9, 1.1, count)
    return resistance, 0.2086 * rng.uniform(0.95, 1.05, count), keys


def sampled(engine: str, batch, steps: int, threads=None, **choice: Any):
    """A function without arguments that runs the batch, compiled already but for the first
    call: what is kept of the last sample, shape `(N, 3, 2)`."""

    @jax.jit
    def run(batch):
        return aslo_run(engine, batch, steps, threads, **choice)

    return lambda: jax.block_until_ready(run(batch))


def aslo_run(engine: str, batch, steps: int, threads=None, **choice: Any):
    from aslo_jax.engines import run_batch

    one = lambda sample: make(sample, **choice)
    out = run_batch(
        one, batch, steps, record=keep, every=steps, engine=engine, threads=threads
    )
    return out.record[:, -1]


def exact(batch, steps: int, noisy: bool = False):
    """The end of the sampled loop, as a plain loop around an accurate plant: diffrax's
    Dopri8 at 1e-12 over every interval, with the voltage held."""
    precise = diffrax.PIDController(rtol=1e-12, atol=1e-14)

    def one(sample):
        loop = make(sample, noisy)
        plant, control = loop.plant, loop.controller
        field = diffrax.ODETerm(lambda t, x, u: plant.vector_field(jnp.asarray(t), x, u))

        def step(state, k):
            x, u, inner, observers = state
            solution = diffrax.diffeqsolve(
                field,
                diffrax.Dopri8(),
                0.0,
                INTERVAL,
                INTERVAL,
                x,
                args=u,
                stepsize_controller=precise,
                adjoint=diffrax.ForwardMode(),
            )
            x = jax.tree.map(lambda x: x[-1], solution.ys)
            t = (k + 1) * loop.interval
            y = plant.output(x)
            y = y if loop.sensor is None else loop.sensor(t, None, y)
            pairs = {
                n: o.step(observers[n], u, y, INTERVAL) for n, o in loop.observers.items()
            }
            observers = {n: p[0] for n, p in pairs.items()}
            fed = measured(y, x, None)
            u, rate = control(t, inner, fed), control.vector_field(t, inner, fed)
            inner = jax.tree.map(lambda s, r: s + INTERVAL * r, inner, rate)
            values = [pairs[n][1].value for n in ("ASLO", "A-ASLO")]
            return (x, u, inner, observers), jnp.stack([x.flux, *values])

        begun, _ = loop.init()
        state = begun.x, begun.command, begun.controller, begun.observers
        return jax.lax.scan(step, state, jnp.arange(steps))[1][-1]

    return jax.jit(jax.vmap(one))(batch)


def continuous(batch, steps: int, solver=None, tolerance: float | None = None):
    """The same for the loop in continuous time, by diffrax: with fixed steps of the
    interval, or with adaptive ones of a relative `tolerance`."""
    end = steps * INTERVAL
    if tolerance is None:
        control, dt0 = diffrax.ConstantStepSize(), INTERVAL
    else:
        control, dt0 = diffrax.PIDController(tolerance, 1e-3 * tolerance), None

    @jax.jit
    @jax.vmap
    def run(sample):
        out = aslo.simulate(
            motor(sample),
            controller(),
            observers(),
            t1=end,
            ts=jnp.array([end]),
            feedback=measured,
            solver=diffrax.Tsit5() if solver is None else solver,
            stepsize_controller=control,
            dt0=dt0,
        )
        return keep(jax.tree.map(lambda x: x[0], out))

    return lambda: jax.block_until_ready(run(batch))


def operations(**choice: Any) -> int:
    """Of one step of one trajectory in the graph of the fused engine, what all
    lanes share not counted, a product with a sum counted as two."""
    from aslo_jax.engines.fused import Fused
    from aslo_jax.engines.plan import Plan

    batch = jax.tree.map(jnp.asarray, samples(1))
    plan = Plan(lambda sample: make(sample, **choice), {}, keep)
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), batch)
    return Fused(plan, like, 1, 1, 1).program.operations
