"""Co-simulation: the loop, disturbances, solvers, batches."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import aslo_jax as aslo
from aslo_jax.disturbances import ParasiticLag, SampledNoise, held_index

PLANT = aslo.plants.IntegratorChain(2)
X0 = jnp.array([0.3, 0.1])


def u(t):
    return jnp.cos(2.0 * t)


def aslo2(rate=3.0, **settings):
    settings = dict(completion=aslo.Repeat()) | settings
    return aslo.AlgebraicObserver(PLANT.relation(), aslo.LowPass(rate), **settings)


def printed(rate=3.0):
    return aslo2(rate, guard=None, start="paper")


def run(observers, **settings):
    settings = dict(t1=2.0, initial=X0, ts=jnp.linspace(0, 2, 41)) | settings
    return aslo.simulate(PLANT, u, observers, **settings)


def test_the_loop_against_scipy():
    """Plant, lag on the actuator, printed ASLO and A-ASLO, written out by hand."""
    lam, gamma, tau = 3.0, 2.0, 0.3

    def rate(t, s):
        x1, x2, v, wu, wy, hat = s
        algebraic = wu / lam + lam * (x1 - wy)
        return [
            x2,
            v,
            (np.cos(2 * t) - v) / tau,
            lam * (np.cos(2 * t) - wu),
            lam * (x1 - wy),
            np.cos(2 * t) - gamma * (hat - algebraic),
        ]

    ts = np.linspace(0, 2, 41)
    start = [0.3, 0.1, 0, 0, 0, 0.4]
    s = scipy.integrate.solve_ivp(
        rate, (0, 2), start, "DOP853", ts, rtol=1e-12, atol=1e-12
    ).y
    algebraic = s[3] / lam + lam * (s[0] - s[4])
    smooth = aslo.Asymptotic(printed(lam), gamma, initial=jnp.array([0.4]))
    solution = run(
        {"ASLO": printed(lam), "A-ASLO": smooth},
        actuator=ParasiticLag(tau),
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.PIDController(rtol=1e-11, atol=1e-12),
    )
    np.testing.assert_allclose(solution.x, s[:2].T, atol=1e-8)
    np.testing.assert_allclose(solution.estimates["ASLO"].value[:, 0], algebraic, atol=1e-8)
    np.testing.assert_allclose(solution.estimates["A-ASLO"].value[:, 0], s[5], atol=1e-8)
    np.testing.assert_allclose(solution.u, np.cos(2 * ts), atol=1e-15)
    np.testing.assert_allclose(solution.error("ASLO")[:, 0], algebraic - s[1], atol=1e-8)


def test_inner_signals_are_recorded_by_name():
    solution = run({"ASLO": aslo2()})
    rho = solution.states["ASLO"]["row.r"][:, 0]
    np.testing.assert_allclose(rho, 1 - jnp.exp(-3.0 * solution.t), atol=1e-6)


def test_fixed_steps_converge_at_the_order_of_the_solver():
    reference = run(
        {"A": printed()},
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-12),
    ).error("A")[-1]
    errors = []
    for dt0 in (0.1, 0.05, 0.025):
        steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=dt0)
        error = run({"A": printed()}, solver=diffrax.Bosh3(), **steps).error("A")[-1]
        errors.append(float(jnp.abs(error - reference)[0]))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (np.abs(orders - 3) < 0.25).all(), errors


def noise(deviation=0.3, interval=0.05, stream=0):
    return SampledNoise(deviation, interval, aslo.random.key(4), stream)


@pytest.mark.parametrize("t0", [pytest.param(0.0, marks=pytest.mark.slow), 0.35])
def test_held_noise_is_held_to_the_bit_for_adaptive_and_fixed_steps(t0):
    """Against the exact recurrence: the noisy input is piecewise constant, so the filter
    advances exactly over each of its intervals."""
    ts = jnp.arange(round(t0 / 0.05), 41) * 0.05
    plant = aslo.plants.IntegratorChain(2)
    settings = dict(t0=t0, t1=2.0, ts=ts, initial=X0, input_sensor=noise())
    tight = diffrax.PIDController(rtol=1e-10, atol=1e-12)
    fixed = diffrax.ConstantStepSize()
    solutions = [
        aslo.simulate(plant, lambda t: 0.0 * t, {"A": printed()}, **settings, **how)
        for how in (
            dict(solver=diffrax.Dopri8(), stepsize_controller=tight),
            dict(solver=diffrax.Dopri8(), stepsize_controller=fixed, dt0=0.025),
        )
    ]
    held = [
        0.3 * aslo.random.normal(aslo.random.key(4), k, 0, ())
        for k in range(round(t0 / 0.05), 40)
    ]
    w, expected, a = 0.0, [0.0], np.exp(-3.0 * 0.05)
    for v in held:
        w = a * w + (1 - a) * v
        expected.append(w)
    for solution in solutions:
        # error of the printed ASLO: the filtered noise over lambda, and its transient
        transient = (3 * 0.3 - 0.1) * jnp.exp(-3.0 * (ts - t0))
        noisy = solution.error("A")[:, 0] - transient
        np.testing.assert_allclose(noisy, np.array(expected) / 3.0, atol=1e-7)
    assert np.abs(expected).max() > 0.05


@pytest.mark.parametrize("fixed", [False, True], ids=["adaptive", "fixed"])
def test_noise_under_jit(fixed):
    steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.025) if fixed else {}
    settings = dict(input_sensor=noise(), t1=0.5, ts=jnp.linspace(0, 0.5, 11)) | steps
    jitted = jax.jit(lambda x0: run({"A": printed()}, initial=x0, **settings).error("A"))
    plain = run({"A": printed()}, **settings).error("A")
    np.testing.assert_allclose(jitted(X0), plain, atol=1e-9)


def test_fixed_steps_that_do_not_fit_the_noise_are_refused():
    steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.03)
    with pytest.raises(ValueError, match="`dt0` must divide the interval of every held"):
        run({"A": printed()}, input_sensor=noise(), **steps)


def test_sensor_noise_reaches_everyone_and_two_streams_differ():
    solution = run({"A": printed()}, sensor=noise(), input_sensor=noise(stream=1))
    assert jnp.abs(solution.y - solution.x[:, 0]).max() > 0.1
    k = 7
    at = jnp.asarray(k * 0.05)
    expected = u(at) + 0.3 * aslo.random.normal(aslo.random.key(4), k, 1, ())
    np.testing.assert_allclose(solution.u[k], expected, rtol=1e-12)


@pytest.mark.parametrize("interval", [0.1, 1e-3, 0.07, 1 / 3])
def test_held_index_at_the_edges(interval):
    k = np.arange(1, 3000)
    edge = jnp.asarray(k * interval)
    at, before = (
        jax.jit(jax.vmap(lambda t: held_index(t, interval)))(t)
        for t in (edge, jnp.nextafter(edge, -jnp.inf))
    )
    np.testing.assert_array_equal(at, k)
    np.testing.assert_array_equal(before, k - 1)


@pytest.mark.slow
def test_vmap_over_initial_states_and_parameters():
    def error(x0, rate, gain):
        observer = aslo.Asymptotic(printed(rate), gain, initial=jnp.zeros(1))
        return run({"A": observer}, initial=x0).error("A")[:, 0]

    x0 = jnp.array([[0.3, 0.1], [0.0, -1.0], [1.0, 2.0]])
    rates, gains = jnp.array([2.0, 5.0, 9.0]), jnp.array([1.0, 3.0, 4.0])
    batch = jax.vmap(error)(x0, rates, gains)
    for k in range(3):
        single = error(x0[k], rates[k], gains[k])
        np.testing.assert_allclose(batch[k], single, atol=1e-7)
    assert np.abs(batch[0] - batch[1]).max() > 0.1


def test_single_precision():
    single = jax.tree.map(lambda x: x.astype(jnp.float32), (PLANT, aslo2()))
    solution = aslo.simulate(
        single[0],
        u,
        {"A": single[1]},
        t1=2.0,
        initial=X0.astype(jnp.float32),
        ts=jnp.linspace(0, 2, 21, dtype=jnp.float32),
        stepsize_controller=diffrax.PIDController(rtol=1e-5, atol=1e-7),
    )
    assert solution.estimates["A"].value.dtype == jnp.float32
    assert jnp.abs(solution.error("A"))[2:].max() < 1e-3


def test_a_motor_turns_and_its_flux_is_found():
    motor = aslo.plants.PMSM(
        8.875, 40.03e-3, 0.2086, 5, 60e-6, friction=1e-4, load=lambda t: 0.02 * t
    )

    def voltage(t):
        a = 5 * (10 * t + 20 * t**2) + 1.0
        return (4.0 + 60 * t) * jnp.stack([jnp.cos(a), jnp.sin(a)])

    observers = {"ASLO": aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(40.0))}
    ts = jnp.linspace(0, 0.5, 4001)
    solution = aslo.simulate(motor, voltage, observers, t1=0.5, ts=ts)
    assert jnp.abs(solution.x.speed[-1]) > 10
    assert jnp.abs(solution.error("ASLO"))[ts > 0.02].max() < 1e-6
    # Power balance: u'i = R i^2 + torque speed + d/dt(L i^2 / 2), in amplitude-invariant
    # quantities times 3/2, integrated over the run.
    i = solution.y
    electrical = 1.5 * jnp.sum(solution.u * i - motor.resistance * i**2, axis=1)
    stored = 0.75 * motor.inductance * jnp.sum(i**2, axis=1)
    kinetic = 0.5 * motor.inertia * solution.x.speed**2
    losses = (motor.friction * solution.x.speed + 0.02 * ts) * solution.x.speed
    work = scipy.integrate.cumulative_simpson(electrical - losses, x=ts, initial=0)
    np.testing.assert_allclose(stored + kinetic, work, atol=2e-3 * float(kinetic.max()))


def test_arguments_are_refused():
    with pytest.raises(ValueError, match=r"`t1` must be after t0 = 0\.0 s"):
        run({}, t1=-1.0)
    with pytest.raises(ValueError, match=r"`ts` must lie in \[0\.0, 2\.0\] s"):
        run({}, ts=jnp.array([0.0, 3.0]))
    with pytest.raises(ValueError, match="`ts` must be a strictly increasing"):
        run({}, ts=jnp.array([0.0, 1.0, 1.0]))
    with pytest.raises(ValueError, match="`tau` must be positive"):
        ParasiticLag(0.0)
    with pytest.raises(ValueError, match="`interval` must be positive"):
        noise(interval=-0.1)
    with pytest.raises(ValueError, match="`order` must be at least 2"):
        aslo.plants.IntegratorChain(1)
    with pytest.raises(ValueError, match=r"`inductance` must be positive and finite \(H\)"):
        aslo.plants.PMSM(8.0, -0.04, 0.2, 5, 6e-5)
