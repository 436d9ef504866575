"""The magnetic bearing: its physics, and fluxes, position and velocity without a sensor."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import PrescribedBearing, observe

import aslo_jax as aslo
from aslo_jax.observers import BearingObserver
from aslo_jax.plants import BearingState, MagneticBearing

BEARING = MagneticBearing.laboratory(resistance=jnp.array([2.0, 2.7]))
K = float(BEARING.force_constant)
GUARD = aslo.Guard()


MOTION = PrescribedBearing(BEARING)


def observer(flux_guard=GUARD, guard=GUARD):
    flux = aslo.AlgebraicObserver(
        BEARING.flux_relation(), aslo.LowPass(80.0), guard=flux_guard
    )
    return BearingObserver(flux, aslo.LowPass(200.0), guard)


def relative(values, truth):
    """Errors relative to the largest of fluxes, position, velocity, shape `(N, 4)`."""
    size = jnp.abs(truth).max(axis=0)
    return jnp.abs(values - truth) / size.at[:2].set(size[:2].max())


def log(dt, t1=0.5, motion=MOTION):
    t = jnp.arange(round(t1 / dt) + 1) * dt
    return t, *_signals(motion, t, t + dt)


@eqx.filter_jit
def _signals(motion, t, end):
    u = jax.vmap(motion.mean_voltage)(t, end)
    return u, jax.vmap(motion.current)(t), jax.vmap(motion.truth)(t)


def test_the_motion_solves_the_equations_of_the_bearing():
    for t in jnp.array([0.0, 0.013, 0.2]):
        rate = BEARING.vector_field(t, MOTION.state(t), MOTION.voltage(t))
        _, expected = jax.jvp(MOTION.state, (t,), (jnp.ones_like(t),))
        for a, b in zip(jax.tree.leaves(rate), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-11)


def test_power_balance_and_forces():
    """Energy, and the force as the slope of the co-energy at constant currents."""
    rng = np.random.default_rng(2)
    x = BearingState(
        jnp.asarray(rng.uniform(2e-3, 9e-3, 2)), jnp.asarray(1.7e-4), jnp.asarray(0.2)
    )
    u, force = jnp.asarray([3.0, -1.0]), lambda t: 4.0 + 0.0 * t
    bearing = eqx.tree_at(lambda b: b.force, BEARING, force)
    rate = bearing.vector_field(jnp.zeros(()), x, u)
    i = bearing.output(x)
    _, storing = jax.jvp(bearing.energy, (x,), (rate,))
    supplied = jnp.sum(u * i - bearing.resistance * i**2) + 4.0 * x.velocity
    np.testing.assert_allclose(storing, supplied, rtol=1e-11)

    def coenergy(q):
        g = bearing.gap
        return 0.25 * K * (i[0] ** 2 / (g - q) + i[1] ** 2 / (g + q))

    expected = (jax.grad(coenergy)(x.position) + 4.0) / bearing.mass
    np.testing.assert_allclose(rate.velocity, expected, rtol=1e-11)


def test_against_scipy():
    """Released off centre under constant voltages, it falls to one side."""
    R, g, m = np.asarray(BEARING.resistance), float(BEARING.gap), float(BEARING.mass)

    def rate(t, s):
        psi, (q, v) = s[:2], s[2:]
        i = 2 / K * np.array([g - q, g + q]) * psi
        dpsi = np.array([2.0, 2.8]) - R * i
        return [*dpsi, v, (psi[0] ** 2 - psi[1] ** 2) / K / m]

    ts = jnp.linspace(0, 0.02, 5)
    x0 = eqx.tree_at(lambda x: x.position, BEARING.initial(), jnp.asarray(2e-5))
    tight = dict(rtol=1e-12, atol=1e-15)
    expected = scipy.integrate.solve_ivp(
        rate, (0, 0.02), np.asarray(BEARING.hidden(x0)), "DOP853", np.asarray(ts), **tight
    ).y.T
    found = aslo.simulate(
        BEARING,
        lambda t: jnp.array([2.0, 2.8]),
        {"bearing": observer()},
        t1=0.02,
        ts=ts,
        initial=x0,
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=1e-12, atol=1e-20), step_ts=ts
        ),
    )
    np.testing.assert_allclose(found.hidden, expected, rtol=1e-9, atol=1e-12)
    assert abs(found.x.position[-1]) > 4e-5
    error = relative(found.estimates["bearing"].value, found.hidden)
    assert error[-1].max() < 1e-6


def test_a_touch_down_bearing_pushes_and_never_pulls():
    """A spring and a damper side by side: a dropped body falls free, bounces, and comes to
    rest at the depth that the spring needs."""
    clearance, weight = 3e-4, 9.81
    bearing = MagneticBearing.laboratory(
        force=lambda t: -weight + 0 * t, bias=1e-9, touchdown=clearance
    )
    stiffness, damping = bearing.touchdown_stiffness, bearing.touchdown_damping

    def support(q, v):
        state = BearingState(jnp.zeros(2), jnp.asarray(q), jnp.asarray(v))
        return bearing.support(state)

    assert support(2.9e-4, 1.0) == 0.0 == support(-2.9e-4, -1.0)
    np.testing.assert_allclose(support(3.1e-4, 2e-2), -1e-5 * stiffness - 2e-2 * damping)
    np.testing.assert_allclose(support(-3.2e-4, -1e-2), 2e-5 * stiffness + 1e-2 * damping)
    assert support(3.1e-4, -1.0) == 0.0  # it leaves faster than the spring follows
    ts = jnp.linspace(0.0, 0.06, 601)
    run = aslo.simulate(
        bearing, lambda t: jnp.zeros(2), {}, t1=0.06, ts=ts, max_steps=20_000
    )
    fall = np.sqrt(2 * clearance / weight)
    before = ts < fall
    np.testing.assert_allclose(
        run.x.position[before], -weight * ts[before] ** 2 / 2, atol=1e-9
    )
    assert run.x.velocity.max() > 1e-2  # it bounces
    rest = -clearance - weight / stiffness
    np.testing.assert_allclose(run.x.position[-1], rest, rtol=1e-6)


@pytest.mark.slow
def test_everything_from_the_currents():
    ts = jnp.concatenate([jnp.array([0.02, 0.03]), jnp.linspace(0.05, 0.5, 19)])
    estimate = observe(observer(), MOTION.voltage, MOTION.current, ts)
    truth = jax.vmap(MOTION.truth)(ts)
    error = relative(estimate.value, truth)
    assert error[ts >= 0.05].max() < 1e-6
    assert not estimate.coasting[ts >= 0.05].any()
    assert jnp.abs(truth[:, 2]).max() > 1e-4 and jnp.abs(truth[:, 3]).max() > 5e-3


def test_velocity_is_exact_as_soon_as_the_fluxes_are_certified():
    """The weight forgets a position that meant nothing: 10 ms after the start of a filter
    of 5 ms a plain rate relation would still carry a seventh of it."""
    ts = jnp.array([5e-3, 1e-2, 1.5e-2])
    estimate = observe(observer(), MOTION.voltage, MOTION.current, ts)
    error = relative(estimate.value, jax.vmap(MOTION.truth)(ts))
    assert not estimate.coasting[1:].any()
    assert error[1:].max() < 1e-9


def test_order_two_when_sampled():
    """Of the velocity, whose forces are products; the fluxes and the position that they
    tell have no error of sampling."""
    errors = []
    for dt in (4e-4, 2e-4):
        t, u, y, truth = log(dt, 2500 * dt)  # of one length: compiled once
        error = relative(aslo.replay(observer(), t, u, y).value, truth)
        errors.append(jnp.sqrt(jnp.mean(error[(t > 0.2) & (t <= 0.5)] ** 2, axis=0)))
        assert error[t > 0.05].max() < 2e-3 * (dt / 4e-4) ** 2
    assert errors[0][:-1].max() < 1e-9
    assert 1.9 < jnp.log2(errors[0][-1] / errors[1][-1]) < 2.1, errors


def pause(t):
    """Time that stands still from 0.3 to 0.5 s, smoothly so over 0.1 s before and after."""

    def stop(t):  # the integral of 1 - 10 x^3 + 15 x^4 - 6 x^5 over x = t/0.1
        x = jnp.clip(t / 0.1, 0.0, 1.0)
        return 0.1 * (x - 2.5 * x**4 + 3 * x**5 - x**6)

    before = jnp.minimum(t, 0.2) + stop(t - 0.2)
    return before + jnp.maximum(t - 0.6, 0.0) + stop(jnp.asarray(0.1)) - stop(0.6 - t)


def test_at_rest_it_coasts_and_comes_back():
    motion = PrescribedBearing(BEARING, pause)
    t, u, y, truth = log(1e-4, 1.0, motion)
    guarded = observer(aslo.Guard(1e-5), aslo.Guard(1e-4))
    estimate = aslo.replay(guarded, t, u, y)
    error = relative(estimate.value, truth)
    assert estimate.coasting[(t > 0.4) & (t < 0.5)].all()
    assert not estimate.coasting[t > 0.65].any()
    assert error[t > 0.05].max() < 2e-3
    assert jnp.abs(truth[5000, 2]) > 1e-5 and jnp.abs(truth[6500, 3]) > 1e-3


def test_a_control_loop_steps():
    _, u, y, _ = log(4e-4, 0.1)
    t = np.arange(len(u)) * 4e-4
    whole = aslo.replay(observer(), t, u, y)
    state, step = observer().init(y[0], u[0]), eqx.filter_jit(observer().step)
    for k in range(1, len(u)):
        state, estimate = step(state, u[k - 1], y[k], 4e-4)
    np.testing.assert_allclose(estimate.value, whole.value[-1], rtol=1e-9)


def test_gains_and_parameters_have_gradients():
    t, u, y, truth = log(4e-4, 0.1)

    def loss(observer):
        return jnp.mean(relative(aslo.replay(observer, t, u, y).value, truth)[150:] ** 2)

    gradient = eqx.filter_jit(eqx.filter_grad(loss))(observer())
    relation = gradient.flux.relation
    for leaf in (relation.resistance, relation.gap, relation.mass, gradient.filter.rate):
        assert jnp.isfinite(leaf).all() and (leaf != 0).all()


def test_what_does_not_fit_is_refused():
    relation = aslo.plants.FluxRelation(1.0, 1e-3)
    flux = aslo.AlgebraicObserver(relation, aslo.LowPass(5.0))
    with pytest.raises(ValueError, match="`flux` must have a `BearingFluxRelation`, but"):
        BearingObserver(flux, aslo.LowPass(5.0))
    with pytest.raises(ValueError, match="`flux` must have a guard, but it has none"):
        observer(flux_guard=None)
    with pytest.raises(ValueError, match=r"`touchdown` must be positive and finite \(m\)"):
        MagneticBearing.laboratory(touchdown=0.0)
