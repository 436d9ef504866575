"""The sampled closed loop, field-oriented control, and the start without an angle."""

import dataclasses

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, ForcedStart, MotorFeedback
from aslo_jax.disturbances import ParasiticLag, SampledNoise

PAPER_LOAD = 3.0


def motor(load=lambda t: PAPER_LOAD + 0.5 * jnp.sin(0.1 * t), **settings):
    settings = dict(inertia=60e-6) | settings
    return aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, load=load, **settings)


def reference(t):
    return 2.0 + 0.5 * jnp.sin(t)


def encoder(y, x, estimates):
    del estimates
    return MotorFeedback(y, 5 * x.angle, x.speed)


def flux_observer(plant, rate=5.0, **settings):
    return aslo.AlgebraicObserver(plant.flux_relation(), aslo.LowPass(rate), **settings)


def measured_angle(plant=None, **settings):
    plant = motor() if plant is None else plant
    control = FieldOriented(plant, reference, current_limit=2.4, voltage_limit=150.0)
    settings = dict(interval=1e-4, feedback=encoder, plant_steps=2) | settings
    return aslo.Experiment(plant, control, {"ASLO": flux_observer(plant)}, **settings)


def test_the_paper_s_speed_and_load_are_followed():
    record = measured_angle().run(15_000, every=20)
    late = record.t > 1.0
    assert jnp.abs(record.x.speed - reference(record.t))[late].max() < 0.05
    # 3 Nm take 2.24 A in the amplitude-invariant convention, 3.36 A in the printed one.
    size = jnp.linalg.norm(record.y, axis=1)
    torque = PAPER_LOAD + 0.5 * jnp.sin(0.1 * record.t)
    np.testing.assert_allclose(size[late], torque[late] / (1.5 * 5 * 0.2086), rtol=2e-2)
    assert jnp.abs(record.estimates["ASLO"].value - record.hidden)[late].max() < 1e-4


def test_a_loop_written_out_by_hand():
    """Python, SciPy for the plant, `observer.step`, and Euler for the controller."""
    plant = motor(friction=1e-3)
    noise = SampledNoise(0.01, 1e-4, aslo.random.key(3))
    experiment = measured_angle(plant, sensor=noise, plant_steps=8)
    record = experiment.run(25)
    observer, control = experiment.observers["ASLO"], experiment.controller
    step = eqx.filter_jit(observer.step)
    n, h, x = 5, 1e-4, np.array([0.2086, 0.0, 0.0, 0.0])

    def current(x):
        magnet = 0.2086 * np.array([np.cos(n * x[3]), np.sin(n * x[3])])
        return (x[:2] - magnet) / 40.03e-3

    def measured(k, x):
        numbers = aslo.random.normal(aslo.random.key(3), k, 0, (2,))
        return current(x) + 0.01 * np.asarray(numbers)

    def rate(t, x, u):
        i = current(x)
        torque = 1.5 * n * (x[0] * i[1] - x[1] * i[0])
        load = 3 + 0.5 * np.sin(0.1 * t) + 1e-3 * x[2]
        return [*(u - 8.875 * i), (torque - load) / 60e-6, x[2]]

    y = measured(0, x)
    fed = MotorFeedback(jnp.asarray(y), jnp.asarray(n * x[3]), jnp.asarray(x[2]))
    state, seen = control.init(fed), observer.init(jnp.asarray(y), jnp.zeros(2))
    for k in range(25):
        np.testing.assert_allclose(record.y[k], y, atol=1e-9)
        u = np.asarray(control(jnp.asarray(k * h), state, fed))
        np.testing.assert_allclose(record.u[k], u, rtol=1e-7, atol=1e-7)
        slope = control.vector_field(jnp.asarray(k * h), state, fed)
        state = jax.tree.map(lambda s, r: s + h * r, state, slope)
        x = scipy.integrate.solve_ivp(
            rate, (k * h, (k + 1) * h), x, "DOP853", args=(u,), rtol=1e-11, atol=1e-12
        ).y[:, -1]
        y = measured(k + 1, x)
        seen, estimate = step(seen, jnp.asarray(u), jnp.asarray(y), h)
        np.testing.assert_allclose(
            record.estimates["ASLO"].value[k + 1], estimate.value, atol=1e-7
        )
        fed = MotorFeedback(jnp.asarray(y), jnp.asarray(n * x[3]), jnp.asarray(x[2]))


def test_recording_every_tenth_sample_changes_nothing():
    experiment = measured_angle()
    all_of_it, tenth = experiment.run(200), experiment.run(200, every=10)
    for a, b in zip(jax.tree.leaves(all_of_it), jax.tree.leaves(tenth), strict=True):
        np.testing.assert_allclose(a[::10], b, rtol=1e-12, atol=1e-13)


def test_the_sampled_loop_approaches_the_continuous_one():
    plant = motor(friction=1e-3, load=lambda t: 0.3 + 0.1 * t, inertia=2e-3)
    control = FieldOriented(
        plant, reference, current_limit=2.4, current_bandwidth=300.0, speed_bandwidth=30.0
    )
    solution = aslo.simulate(
        plant, control, {}, t1=0.5, feedback=encoder, ts=jnp.linspace(0, 0.5, 51),
        solver=diffrax.Dopri8(),
    )  # fmt: skip
    errors = []
    for steps in (2_500, 5_000):
        sampled = aslo.Experiment(plant, control, {}, 0.5 / steps, feedback=encoder)
        record = sampled.run(steps, every=steps // 50)
        errors.append(float(jnp.abs(record.x.speed - solution.x.speed).max()))
    assert errors[0] < 0.02
    assert 1.8 < errors[0] / errors[1] < 2.2  # a held voltage: first order in the interval


def test_a_limited_current_does_not_wind_up():
    """A step that saturates for long, then is taken back: no overshoot to pay for it."""
    plant = motor(lambda t: jnp.zeros_like(t), inertia=5e-3)

    def step(t):
        return jnp.where(t < 0.3, 200.0, 20.0)

    control = FieldOriented(plant, step, current_limit=2.0, speed_bandwidth=60.0)
    loop = aslo.Experiment(plant, control, {}, 1e-4, feedback=encoder)
    record = loop.run(12_000, every=20)
    limit = 1.5 * 5 * 0.2086 * 2.0 / 5e-3 * 0.3
    peak = record.x.speed.max()
    assert peak < 1.02 * limit
    assert jnp.linalg.norm(record.y, axis=1).max() < 2.4  # the reversal overshoots
    assert record.x.speed[record.t > 0.4].min() > 18.0
    assert jnp.abs(record.x.speed - 20.0)[record.t > 0.9].max() < 0.05


def sensorless_start(load, angle):
    """A forced start, then the flux observer and the phase-locked loop, from an electrical
    angle of `5 angle` that nobody is told."""
    plant = motor(load)
    flux = flux_observer(plant, 30.0, guard=aslo.Guard(1e-3), initial=[0.2, 0.0])
    observer = aslo.Staged(
        flux,
        aslo.PhaseLockedLoop(1000.0),
        lambda u, y, e: (u, jnp.arctan2(*(e.value - plant.inductance * y)[::-1])),
    )
    control = FieldOriented(plant, reference, current_limit=2.4, voltage_limit=200.0)
    start = ForcedStart(control, current=2.3, speed=3.0, acceleration=5.0)
    return plant, start, {"ASLO": observer}, turned(plant, angle)


def turned(plant, angle):
    """At rest without current, the rotor at a mechanical angle."""
    magnet = 0.2086 * jnp.array([np.cos(5 * angle), np.sin(5 * angle)])
    where = lambda x: (x.flux, x.angle)
    return eqx.tree_at(where, plant.initial(), (magnet, jnp.asarray(angle)))


def sensorless(y, x, estimates):
    del x
    found = estimates["ASLO"]["second"].value
    return MotorFeedback(y, found[0], found[1] / 5)


def angle_error(run):
    found = run.estimates["ASLO"]["second"].value
    return jnp.abs(aslo.observers.wrap(found[:, 0] - 5 * run.x.angle))


@pytest.fixture(scope="module")
def sensorless_loop():
    """The load comes in over 1.5 s. One object, and so compiled once for every angle."""
    plant, start, observers, _ = sensorless_start(
        lambda t: 2.8 * jnp.clip((t - 1.5) / 1.5, 0.0, 1.0), 0.0
    )
    return aslo.Experiment(
        plant, start, observers, 1e-4, feedback=sensorless, plant_steps=2
    )


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.3, np.pi / 5])
def test_sensorless_start_from_an_unknown_angle(sensorless_loop, angle):
    """Forced for 1.1 s, then on the flux observer and the phase-locked loop. The last angle
    is opposite to the forced one."""
    start = sensorless_loop.controller
    first = turned(sensorless_loop.plant, angle)
    record = dataclasses.replace(sensorless_loop, initial=first).run(45_000, every=50)
    locked = record.t > start.handover
    assert angle_error(record)[locked].max() < 0.02
    assert not record.estimates["ASLO"]["first"].coasting[locked].any()
    assert jnp.abs(record.x.speed - reference(record.t))[record.t > 4.0].max() < 0.1


@pytest.mark.slow
def test_sensorless_in_continuous_time():
    """The same start, the load coming in over 0.3 s, everything in one solve."""
    plant, start, observers, first = sensorless_start(
        lambda t: 2.8 * jnp.clip((t - 1.5) / 0.3, 0.0, 1.0), 0.4
    )
    run = jax.jit(
        lambda: aslo.simulate(
            plant, start, observers, t1=2.0, ts=jnp.linspace(0.0, 2.0, 401),
            initial=first, feedback=sensorless,
            stepsize_controller=diffrax.PIDController(rtol=1e-6, atol=1e-8),
        )
    )()  # fmt: skip
    locked = run.t > start.handover
    assert angle_error(run)[locked].max() < 0.01
    assert not run.estimates["ASLO"]["first"].coasting[locked].any()
    assert jnp.abs(run.estimates["ASLO"]["first"].value - run.hidden)[locked].max() < 1e-5
    # While the load rises, the speed lags by its rate over b^2 J/4 = 1.35 N m/rad.
    error = run.x.speed - reference(run.t)
    rising = (run.t > 1.6) & (run.t < 1.8)
    np.testing.assert_allclose(error[rising], -(2.8 / 0.3) / 1.35, rtol=0.15)
    assert jnp.abs(error)[run.t > 1.9].max() < 0.05


def test_a_lag_of_the_actuator_is_integrated_with_the_plant():
    plant = aslo.plants.IntegratorChain(2)
    control = aslo.control.OpenLoop(lambda t: jnp.cos(3 * t))
    loop = aslo.Experiment(
        plant, control, {}, 0.01, actuator=ParasiticLag(0.05), plant_steps=4
    )
    record = loop.run(100)
    v, x2 = 0.0, 0.0
    for k in range(100):
        held, a = np.cos(0.03 * k), np.exp(-0.01 / 0.05)
        x2 += held * 0.01 + (v - held) * 0.05 * (1 - a)
        v = held + (v - held) * a
    np.testing.assert_allclose(record.x[-1, 1], x2, rtol=1e-7)


@pytest.mark.slow
def test_a_loop_is_one_pytree_to_map_and_to_differentiate():
    def loss(rate, resistance):
        experiment = measured_angle(plant_steps=1)
        wrong = eqx.tree_at(
            lambda e: (e.observers["ASLO"].filter.rate, e.plant.resistance),
            experiment,
            (rate, resistance),
        )
        record = wrong.run(300, every=10)
        return 1e4 * jnp.mean((record.estimates["ASLO"].value - record.hidden)[10:] ** 2)

    rate, R = jnp.asarray(60.0), jnp.asarray(9.2)
    both = jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))
    value, gradients = both(rate, R)
    for k, (x, gradient) in enumerate(zip((rate, R), gradients, strict=True)):
        step = 1e-4 * x
        ends = [(rate + s, R) if k == 0 else (rate, R + s) for s in (step, -step)]
        central = (both(*ends[0])[0] - both(*ends[1])[0]) / (2 * step)
        np.testing.assert_allclose(gradient, central, rtol=1e-5)
    batch = jax.jit(jax.vmap(loss, (None, 0)))(rate, jnp.array([8.875, 9.2]))
    np.testing.assert_allclose(batch[1], value, rtol=1e-9)
    assert batch[0] < batch[1]


def test_arguments_are_refused():
    with pytest.raises(ValueError, match=r"`every` must divide `steps`.*steps = 10"):
        measured_angle().run(10, every=3)
    with pytest.raises(ValueError, match=r"`interval` must be positive and finite \(s\)"):
        measured_angle(interval=0.0)
    with pytest.raises(ValueError, match="ParasiticLag has one; use it as `actuator`"):
        measured_angle(sensor=ParasiticLag(0.1)).init()
    with pytest.raises(ValueError, match=r"`current_limit` must be positive and finite"):
        FieldOriented(motor(), reference, current_limit=-1.0)
