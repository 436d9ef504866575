"""One list of observers, one battery for all. Adding an observer means adding a line."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import Prescribed, PrescribedBearing, PrescribedMechanism, PrescribedPMSM

import aslo_jax as aslo
from aslo_jax.filters import bias_rejecting, second_order, sinusoid_rejecting
from aslo_jax.schedules import FastStart, PerSpeed

MOTOR = PrescribedPMSM()
CHAIN = aslo.plants.IntegratorChain(2).relation()
FLUX = MOTOR.relation()
PARTS = dict(guard=aslo.Guard(1e-4), initial=[0.1])
FAST = aslo.LowPass(30.0)


def leg_position(t):
    """Angular momentum is conserved: `m1 q1^2 q2' + m2 q3' = 0.4` with m1 = 2, m2 = 3."""
    length = jnp.sqrt(1.0 + 0.3 * jnp.sin(2 * t))
    angle = 0.4 + 0.8 * t + 0.6 * jnp.sin(2 * t)  # and the integral of q1^2 q2':
    turned = angle - 0.12 * jnp.cos(2 * t) + 0.09 * jnp.sin(2 * t) ** 2
    return jnp.stack([length, angle, (0.4 * t - 2 * turned) / 3])


def damped_leg():
    """A leg with a force on every coordinate, and friction that varies with its length."""
    return aslo.plants.MechanicalSystem(
        lambda q: jnp.stack([2.0 + 0.0 * q[0], 2.0 * q[0] ** 2, 3.0 + 0.0 * q[0]]),
        position=[1.0, 0.4, -0.3],
        friction=lambda q: jnp.stack([0.5 + q[0] ** 2, 0.3 + q[0], 0.2 + 0.0 * q[0]]),
    )


LEG = PrescribedMechanism(aslo.plants.RoboticLeg(2.0, 3.0), leg_position)
WHEEL = PrescribedMechanism(
    aslo.plants.InertiaWheelPendulum(0.4, 0.1, 1.1),
    # It turns steadily, since the wheel takes what its weight does: 0.1 q2'' = 1.1 sin q1.
    lambda t: jnp.stack([0.3 + 2.5 * t, 0.2 - t - 11 / 2.5**2 * jnp.sin(0.3 + 2.5 * t)]),
)
DAMPED_LEG = PrescribedMechanism(damped_leg(), leg_position)
BEARING = PrescribedBearing(aslo.plants.MagneticBearing.laboratory(), lambda t: 0.15 * t)
SALIENT = Prescribed(
    aslo.plants.InteriorPMSM(8.875, 25e-3, 40.03e-3, 0.2086, 5, 60e-6),
    lambda t: MOTOR.angle(t) / MOTOR.pole_pairs,
    lambda t: PrescribedPMSM(direct=-2.0).current(t) * (1 + 0.4 * jnp.sin(9 * t)),
)

OSCILLATOR = aslo.plants.VanDerPol()


def flux(completion=None, **settings):
    completion = aslo.LeastSquares() if completion is None else completion
    return aslo.AlgebraicObserver(FLUX, FAST, completion, **settings)


def chain(filter, completion=None, **settings):
    completion = aslo.Repeat() if completion is None else completion
    return aslo.AlgebraicObserver(CHAIN, filter, completion, **settings)


OBSERVERS = {
    "chain, repeat": chain(aslo.LowPass(6.0)),
    "chain, least squares": chain(aslo.LowPass(6.0), aslo.LeastSquares()),
    "chain, second order": chain(second_order(5.0)),
    "chain, bias rejecting": chain(bias_rejecting(5.0)),
    "chain, sinusoid rejecting": chain(sinusoid_rejecting(6.0, 20.0)),
    "chain, guarded": chain(aslo.LowPass(6.0), **PARTS),
    "chain, fast start": chain(aslo.LowPass(FastStart(5.0, 60.0))),
    "chain, paper": chain(aslo.LowPass(6.0), guard=None, start="paper"),
    "chain, asymptotic": aslo.Asymptotic(chain(aslo.LowPass(6.0)), 4.0),
    "chain, asymptotic from a guess": aslo.Asymptotic(chain(FAST), 4.0, initial=[0.2]),
    "Luenberger": aslo.ReducedLuenberger.of_chain(2, 6.0),
    "Kalman": aslo.SteadyStateKalman.design(
        [[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 1.0, 1e-4, select=[[0.0, 1.0]]
    ),
    "flux, least squares": flux(),
    "flux, repeat": flux(aslo.Repeat()),
    "flux, bank": flux(aslo.FilterBank([aslo.LowPass(70.0)])),
    "flux, forgetting": flux(aslo.LeastSquares(aslo.LowPass(10.0))),
    "flux, rate by speed": aslo.AlgebraicObserver(FLUX, aslo.LowPass(PerSpeed(3.0, 10.0))),
    "flux, paper": flux(aslo.Repeat(), start="paper"),
    "flux, asymptotic": aslo.Asymptotic(flux(), 20.0),
    "joined": aslo.Joined((chain(FAST), aslo.Asymptotic(chain(FAST), 4.0))),
    "side by side": aslo.SideBySide({"a": chain(FAST), "b": chain(aslo.LowPass(6.0))}),
    "staged": aslo.Staged(
        flux(),
        aslo.PhaseLockedLoop(60.0),
        lambda u, y, e: (
            u,
            jnp.arctan2(*(e.value - MOTOR.inductance * y)[::-1]),
        ),
    ),
    "phase-locked loop": aslo.PhaseLockedLoop(40.0),
    "flux, FO1": aslo.FO1(FLUX, FAST, 1.0),
    "flux, FO1, paper": aslo.FO1(FLUX, FAST, 1.0, start="paper"),
    "flux, FO2": aslo.FO2(FLUX, 1000.0),
    "flux, FO2, both sides": aslo.FO2(FLUX, 1000.0, one_sided=False),
    "flux, FO3": aslo.FO3(FLUX, FAST, 30.0),
    "chain, FO3": aslo.FO3(CHAIN, aslo.LowPass(6.0), 30.0),
    "flux, open loop": aslo.OpenLoopIntegrator(FLUX, MOTOR.flux(jnp.zeros(()))),
    "flux, extended Kalman": aslo.ExtendedKalman.of_pmsm(FLUX, 1e-6, 100.0, 1e-8),
    "flux, lifted": aslo.Lifted(FLUX, 1e-4, 1e-3, interval=2.5e-3),
    "chain, lifted": aslo.Lifted(CHAIN, 1e-3, 1e-2, prior=2.0, interval=2.5e-3),
    "magnet": aslo.AlgebraicMagnet(FLUX, FAST),
    "flux, self-consistent": aslo.SelfConsistent(
        SALIENT.machine.self_consistent_relation(), FAST, 20.0, [0.0, 0.0]
    ),
    "bearing": aslo.BearingObserver(
        aslo.AlgebraicObserver(BEARING.bearing.flux_relation(), aslo.LowPass(12.0)),
        aslo.LowPass(300.0),
    ),
    "leg, velocities": aslo.velocity_observer(LEG.system, aslo.LowPass(6.0)),
    "leg, asymptotic velocities": aslo.velocity_observer(
        LEG.system, aslo.LowPass(6.0), gain=4.0
    ),
    "leg, varying friction": aslo.velocity_observer(DAMPED_LEG.system, aslo.LowPass(6.0)),
    "wheel, lifted velocities": aslo.LiftedVelocities(
        WHEEL.system, 1e-4, 0.01, prior=3.0, interval=2.5e-3
    ),
    "wheel, extended Kalman": aslo.ExtendedKalman.of_mechanical(
        WHEEL.system, 1e-3, 1e-8, initial=WHEEL.position(jnp.zeros(()))
    ),
    "oscillator, copy": aslo.observers.Luenberger.of_plant(OSCILLATOR, 20.0),
    # Those without a model so fast that they lag by less than 1 %.
    "differentiator, filtered": aslo.FilteredDerivative(aslo.LowPass(300.0)),
    "differentiator, high gain": aslo.HighGain(600.0),
    "differentiator, high gain with model": aslo.HighGain(30.0, LEG.system),
    "differentiator, super-twisting": aslo.SuperTwisting([3.0, 4.0, 5.0]),
}
N, DT = 400, 2.5e-3
T = np.arange(N) * DT


def sampled(*signals):
    """The mean of the first over every interval, the others at its beginning."""

    def row(t):
        mean, *others = signals
        return mean(t, t + DT), *(signal(t) for signal in others)

    return jax.jit(jax.vmap(row))(jnp.asarray(T))


# Made of parts that others have too: for these, what takes long is for the slow tests.
VARIANTS = (
    *("chain, second order", "chain, sinusoid rejecting", "chain, paper", "chain, guarded"),
    *("chain, asymptotic from a guess", "flux, forgetting", "flux, paper", "joined"),
    *("side by side", "flux, FO1, paper", "flux, FO2, both sides", "flux, FO3"),
    *("leg, asymptotic velocities", "leg, varying friction", "flux, extended Kalman"),
    "wheel, lifted velocities",
)
variants_are_slow = pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n in VARIANTS else ()) for n in OBSERVERS],
    indirect=True,
    scope="module",
)


@functools.cache
def log(name):
    t = jnp.asarray(T)
    if name == "flux, self-consistent":
        return sampled(SALIENT.mean_voltage, SALIENT.current, SALIENT.flux)
    if name == "bearing":
        return sampled(BEARING.mean_voltage, BEARING.current, BEARING.truth)
    moving = {"leg": LEG, "leg, varying friction": DAMPED_LEG}
    moving["wheel"] = WHEEL
    if name in moving:
        m = moving[name]
        return sampled(m.mean_force, m.position, m.velocity)
    if name == "flux":
        return sampled(MOTOR.mean_voltage, MOTOR.current, MOTOR.flux)
    if name == "joined":
        u, y, speed = log("chain")
        return u, y, jnp.concatenate([speed, speed], axis=1)
    if name == "magnet":
        u, y, flux = log("flux")
        return u, y, flux - MOTOR.inductance * y
    if name == "phase-locked loop":
        angle = MOTOR.angle(t)
        speed = MOTOR.pole_pairs * (2 + 0.5 * jnp.sin(t))
        return 0 * t, angle, jnp.stack([angle, speed], 1)
    if name == "chain":
        u = jnp.cos(2 * t)
        zero = jnp.zeros(1)
        x2 = 0.3 + jnp.concatenate([zero, jnp.cumsum(u[:-1] * DT)])
        x1 = 0.2 + jnp.concatenate([zero, jnp.cumsum((x2 * DT + u * DT**2 / 2)[:-1])])
        return u, x1, x2[:, None]
    if name.startswith("oscillator"):
        force = lambda t: jnp.stack([0.5 * jnp.cos(2 * t)])
        first = jnp.array([0.7, 0.9])
        record = aslo.Experiment(OSCILLATOR, force, {}, DT, initial=first).run(N - 1)
        return record.u, record.y, record.hidden
    if name.startswith(("leg", "differentiator")):
        return log("leg")
    if name.startswith("wheel"):
        return log("wheel")
    return log("flux" if "flux" in name or name == "staged" else "chain")


def values(estimate):
    """The values of an estimate, or of a dictionary of them."""
    leaves = jax.tree.leaves(estimate, is_leaf=lambda e: isinstance(e, aslo.Estimate))
    return [leaf.value for leaf in leaves]


def replay(observer, u, y):
    return aslo.replay(observer, T, u, y, return_state=True)


def test_the_variants_are_observers():
    assert OBSERVERS.keys() > set(VARIANTS)


@pytest.mark.parametrize("motion", [LEG, DAMPED_LEG, WHEEL])
def test_the_mechanisms_can_move_as_prescribed(motion):
    for t in jnp.array([0.0, 0.3, 0.9]):
        q, v, u = motion.position(t), motion.velocity(t), motion.force(t)
        found = motion.system.acceleration(q, v, u)
        np.testing.assert_allclose(found, motion.acceleration(t), atol=1e-10)


# The scope makes the tests of an observer run one after the other: what is compiled for
# one of them serves the next.
@pytest.fixture(params=OBSERVERS, scope="module")
def name(request):
    return request.param


def test_the_estimate_approaches_the_truth(name):
    u, y, truth = log(name)
    found = values(replay(OBSERVERS[name], u, y)[0])
    if name == "staged":
        t = jnp.asarray(T)
        speed = MOTOR.pole_pairs * (2 + 0.5 * jnp.sin(t))
        angle = aslo.observers.wrap(found[1][:, 0] - MOTOR.angle(t))
        assert jnp.abs(angle[-50:]).max() < 0.02
        assert jnp.abs(found[1][-50:, 1] - speed[-50:]).max() < 0.3
        found = found[:1]
    for value in found:
        assert value.shape == truth.shape
        scale = jnp.abs(truth).max(axis=0)
        slow = ("paper", "guess", "FO2", "flux, extended", "Luenberger", "phase")
        bound = 0.15 if any(word in name for word in slow) else 0.01
        assert (jnp.abs(value - truth)[-50:].max(axis=0) < bound * scale).all()


def test_replay_equals_a_loop_of_steps(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    whole, _ = replay(observer, u, y)
    step = eqx.filter_jit(lambda observer, *signals: observer.step(*signals, DT))
    state = observer.init(y[0], u[0])
    for k in range(1, 30):
        state, estimate = step(observer, state, u[k - 1], y[k])
        for a, b in zip(jax.tree.leaves(estimate), jax.tree.leaves(whole), strict=True):
            np.testing.assert_allclose(a, b[k], rtol=1e-10, atol=1e-13)


@variants_are_slow
def test_jit_and_vmap_change_nothing(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    plain, _ = replay(observer, u, y)
    ys = jnp.stack([y, 1.01 * y])
    batch = jax.jit(jax.vmap(lambda y: aslo.replay(observer, T, u, y)))(ys)
    for a, b in zip(*map(values, (plain, batch)), strict=True):
        np.testing.assert_allclose(a, b[0], rtol=1e-8, atol=1e-10)
        assert not np.allclose(b[0], b[1], rtol=1e-6)


@variants_are_slow
def test_every_gain_has_a_gradient(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    # Where the equations hold exactly no gain of theirs matters.
    bent = lambda s: 1e-3 * jnp.cos(jnp.arange(s.size)).reshape(s.shape)
    wrong = lambda s: s[:100] + bent(s[:100])

    def loss(observer):
        found = values(aslo.replay(observer, T[:100], u[:100], wrong(y)))
        return sum(jnp.mean(v[50:] ** 2) for v in found)

    gradient = eqx.filter_jit(eqx.filter_grad(loss))(observer)
    leaves = jax.tree.leaves(eqx.filter(gradient, eqx.is_inexact_array))
    assert leaves
    assert all(jnp.isfinite(leaf).all() for leaf in leaves)
    assert any(jnp.abs(leaf).max() > 0 for leaf in leaves)


@variants_are_slow
def test_single_precision_stays_single_and_close(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    cast = lambda tree: jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, tree
    )
    single, _ = replay(cast(observer), cast(u), cast(y))
    double, _ = replay(observer, u, y)
    for a, b in zip(values(single), values(double), strict=True):
        assert a.dtype == jnp.float32
        scale = jnp.abs(b[-100:]).max()
        np.testing.assert_allclose(a[-100:], b[-100:], atol=2e-3 * scale)


def test_continuous_protocol(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    state = observer.init(y[0], u[0])
    rate = observer.vector_field(jnp.zeros(()), state, u[0], y[0])
    assert jax.tree.structure(rate) == jax.tree.structure(state)
    for a, b in zip(jax.tree.leaves(rate), jax.tree.leaves(state), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(rate))
    estimate = observer.estimate(jnp.zeros(()), state, u[0], y[0])
    assert all(jnp.isfinite(value).all() for value in values(estimate))


def test_the_estimate_has_no_feedthrough_of_the_input(name):
    observer, (u, y, _) = OBSERVERS[name], log(name)
    _, state = replay(observer, u, y)
    estimate = eqx.filter_jit(lambda o, *signals: o.estimate(jnp.zeros(()), *signals))
    a = estimate(observer, state, u[0], y[-1])
    b = estimate(observer, state, u[0] + 7.0, y[-1])
    for p, q in zip(values(a), values(b), strict=True):
        np.testing.assert_array_equal(p, q)


def test_repr_names_the_parts(name):
    observer = OBSERVERS[name]
    assert type(observer).__name__ in repr(observer)
    assert "f64[" not in repr(observer)
    for leaf in jax.tree.leaves(observer):
        if eqx.is_array(leaf) and leaf.ndim == 0:
            assert str(np.asarray(leaf)[()]) in repr(observer)
