"""Velocities of mechanical systems: the identities, their forms, and sampled logs."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mechanisms import STARTS, SYSTEMS, Held, accurate, held, state

import aslo_jax as aslo
from aslo_jax.disturbances import Encoder
from aslo_jax.observers import (
    CoordinateVelocity,
    MomentumRelation,
    SideBySide,
    Staged,
    Unwrapped,
    velocity_observer,
)
from aslo_jax.plants import BallBeam, MechanicalSystem, RoboticLeg
from aslo_jax.structure import structure_of

FAST = aslo.LowPass(5.0)
LEG = SYSTEMS["leg"]


SLOW = [
    pytest.param(n, marks=pytest.mark.slow) for n in ("ball", "cart", "pendulum", "wheel")
]


@pytest.mark.parametrize("name", ["leg", *SLOW])
def test_exact_start(name):
    """Below 1e-8 from 10 ms on, without friction and with constant friction; the A-ASLO as
    well. Friction that is left out is seen."""
    start, ts = STARTS[name], jnp.array([0.01, 0.03, 0.1, 0.5, 2.0])
    friction = 0.1 + 0.3 * jnp.arange(start.velocity.size)
    free, form = structure_of(SYSTEMS[name]), structure_of(damped(name, friction))
    assert "constant" in form.friction and set(free.friction) == {"none"}

    def errors(damping):
        system = damped(name, damping)
        observers = {
            "free": velocity_observer(system, FAST, form=free),
            "damped": velocity_observer(system, FAST, form=form),
            "A-ASLO": velocity_observer(system, FAST, gain=7.0, form=form),
        }
        run = accurate(system, Held(name), observers, start, ts)
        assert not any(e.coasting.any() for e in run.estimates.values())
        return {each: jnp.abs(run.error(each)).max() for each in observers}

    # One after the other: compiled once for both, and in half the time of a batch.
    without, error = errors(0.0 * friction), errors(friction)
    assert max(*without.values(), error["damped"], error["A-ASLO"]) < 1e-8
    assert error["free"] > 1e-3


def damped(name, damping):
    return dataclasses.replace(SYSTEMS[name], damping=damping)


@pytest.mark.slow
def test_exact_start_of_three_stages():
    """A system given as functions, with five coordinates in three stages."""
    ts = jnp.array([0.01, 0.03, 0.1, 0.5, 2.0])
    system, start = SYSTEMS["general"], STARTS["general"]
    observers = {"o": velocity_observer(system, FAST)}
    run = accurate(system, Held("general"), observers, start, ts)
    assert jnp.abs(run.error("o")).max() < 1e-8


def varying(q):
    return jnp.stack([0.2 + 0.1 * q[0] ** 2, 0.3 + 0.2 * jnp.cos(q[0]), 0.1 + 0.0 * q[0]])


VARYING = MechanicalSystem(
    lambda q: jnp.stack([2.0, 2.0 * q[0] ** 2, 3.0]),
    None,
    lambda q: jnp.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]),
    position=[1.0, 0.4, -0.3],
    friction=varying,
)


def test_friction_that_varies_with_position():
    """The bounded form: below 1e-8 at 5 s, and from 10 ms on; without the friction it is
    off."""
    ts = jnp.array([0.01, 0.1, 1.0, 5.0])
    blind = dataclasses.replace(structure_of(VARYING), friction=("none",) * 3)
    observers = {
        "bounded": velocity_observer(VARYING, FAST),
        "without": velocity_observer(VARYING, FAST, form=blind),
    }
    run = accurate(VARYING, Held("leg"), observers, STARTS["leg"], ts)
    assert jnp.abs(run.error("bounded")).max() < 1e-8
    assert (jnp.abs(run.error("without")[-1, :2]) > 1e-3).all()


def printed(system, F, u, q):
    """Prop. 4 as printed, with F[1/z1] replaced by the printed F[z1], the printed sign of
    w2, and both as they hold."""
    m1, m2, lam = system.m1, system.m2, F.filter.rate
    z1, z2 = q[0] ** 2, u[1] / (m1 * q[0] ** 2)
    inverse = F(1.0 / z1, "inverse")
    w1 = F.p(q[1], "q2") + F(z1 * z2 * inverse, "w1") / lam
    w2 = F(u[1], "w2") / (m2 * lam)
    w3 = F.p(q[2], "q3")
    return {
        "q2 as printed": w1 / (z1 * F(z1, "z1")),
        "q2 as it holds": w1 / (z1 * inverse),
        "q3 as printed": w3 + w2,
        "q3 as it holds": w3 - w2,
    }


class Printed(aslo.AbstractObserver):
    system: RoboticLeg
    form: str = eqx.field(static=True)

    def equations(self, F, u, y):
        value = printed(self.system, F.using(FAST, "exact"), u, y)[self.form]
        return aslo.Estimate(value[None], jnp.ones(()), jnp.asarray(False))


def test_the_leg_as_printed_fails_and_as_corrected_holds():
    forms = [f"q{j} {how}" for j in (2, 3) for how in ("as printed", "as it holds")]
    observers = {form: Printed(LEG, form) for form in forms}
    start = dataclasses.replace(STARTS["leg"], velocity=jnp.array([0.2, 1.0, 0.0]))
    ts = jnp.array([0.5, 2.0, 5.0])
    run = accurate(LEG, Held("leg"), observers, start, ts)
    for form, e in run.estimates.items():
        # That F[1] is one in q3 costs nothing where it starts at rest.
        error = jnp.abs(e.value[:, 0] - run.hidden[:, int(form[1]) - 1])
        assert error.max() > 0.05 if "printed" in form else error.max() < 1e-9


def test_the_transient_of_the_paper_start():
    """`(lam q(0) - q'(0)) exp(-lam t)` where the inertia is constant, none where not."""
    observer = velocity_observer(LEG, FAST, start="paper")
    start, ts = STARTS["leg"], jnp.array([0.1, 0.5, 2.0])
    run = accurate(LEG, Held("leg"), {"paper": observer}, start, ts)
    error = run.error("paper")
    decay = jnp.exp(-5.0 * ts)
    for j in (0, 2):
        expected = (5.0 * start.position[j] - start.velocity[j]) * decay
        np.testing.assert_allclose(error[:, j], expected, atol=1e-10)
    assert jnp.abs(error[:, 1]).max() < 1e-10


def test_the_asymptotic_observer_leaves_a_guess_at_its_rate():
    """Of the momentum: `m e = m(0) e(0) exp(-gamma t)` for the first stage. The length
    follows once the angle's velocity has come right."""
    guess = jnp.array([0.5, -1.0, 2.0])
    observer = velocity_observer(LEG, FAST, gain=3.0, initial=guess, guard=None)
    start, ts = STARTS["leg"], jnp.array([0.2, 1.0, 6.0])
    run = accurate(LEG, Held("leg"), {"a": observer}, start, ts)
    m = jax.vmap(LEG.inertia)(run.x.position)
    momentum = jnp.einsum("kij,kj->ki", m, run.error("a"))
    first = LEG.inertia(start.position) @ (guess - start.velocity)
    expected = first * jnp.exp(-3.0 * ts)[:, None]
    np.testing.assert_allclose(momentum[:, 1:], expected[:, 1:], atol=1e-9)
    assert jnp.abs(run.error("a")[-1]).max() < 1e-3


def test_stages_are_ordinary_composition():
    """By hand: the ball beam's angle first, then what it feeds."""
    ball = SYSTEMS["ball"]
    form = structure_of(ball)

    def part(j):
        relation = MomentumRelation(ball, j, "none", form.constant[j])
        observer = aslo.AlgebraicObserver(relation, FAST, aslo.Repeat())
        return CoordinateVelocity(observer)

    def first(u, q, e):
        return u, (q[0], q[1].at[1].set(e.value[0]))

    by_hand = Staged(part(1), part(0), first)
    T = jnp.arange(200) * 1e-3
    q = jnp.stack([0.1 + 0.2 * T, 0.3 + jnp.sin(T)], axis=1)
    u = jnp.cos(T)[:, None]
    ours = aslo.replay(velocity_observer(ball, FAST).observer, T, u, q)
    theirs = aslo.replay(by_hand, T, u, (q, 0.0 * q))
    np.testing.assert_allclose(ours.value[:, 1:], theirs["first"].value, rtol=1e-12)
    np.testing.assert_allclose(ours.value[:, :1], theirs["second"].value, rtol=1e-12)


def experiment(name, observers, **settings):
    system, start = SYSTEMS[name], STARTS[name]
    loop = aslo.Experiment(system, Held(name), observers, 1e-3, initial=start, **settings)
    return loop.run(3000)


@pytest.mark.parametrize("name", ["general", "leg", *SLOW])
def test_sampled_at_a_kilohertz(name):
    """Held inputs: the median relative error of every velocity is below 1e-4."""
    run = experiment(name, {"o": velocity_observer(SYSTEMS[name], aslo.LowPass(10.0))})
    error = np.median(np.abs(run.estimates["o"].value - run.hidden), axis=0)
    assert (error < 1e-4 * np.median(np.abs(run.hidden), axis=0)).all()
    assert np.asarray(run.estimates["o"].coasting).tolist() == [True] + [False] * 3000


@pytest.mark.slow
def test_wrapped_angles_are_unwrapped():
    """An encoder that wraps, finely: the same estimates as without one, over turns."""
    sensor = Encoder(jnp.array([1e-9, 2e-9 * jnp.pi, 2e-9 * jnp.pi]), LEG.angles)
    observer = velocity_observer(LEG, aslo.LowPass(10.0))
    spinning = dataclasses.replace(STARTS["leg"], velocity=jnp.array([0.2, 9.0, -7.0]))
    runs = []
    for each in (None, sensor):
        loop = aslo.Experiment(
            LEG,
            aslo.control.OpenLoop(lambda t: jnp.stack([-160.0 + 0.0 * t, jnp.cos(t)])),
            {"o": observer, "bare": observer.observer},
            1e-3,
            initial=spinning,
            sensor=each,
        )
        runs.append(loop.run(2000))
    plain, wrapped = runs
    assert jnp.ptp(plain.x.position[:, 1:], axis=0).min() > 2 * jnp.pi
    assert wrapped.y[:, 1:].max() < 2 * jnp.pi and wrapped.y[:, 1:].min() >= 0
    a, b = (run.estimates["o"].value[100:] for run in runs)
    np.testing.assert_allclose(b, a, atol=1e-5)
    bare = wrapped.estimates["bare"].value[100:]
    assert jnp.abs(bare - a).max() > 1.0
    assert isinstance(observer, Unwrapped)


def test_estimates_of_each_coordinate():
    observer = velocity_observer(SYSTEMS["ball"], FAST).observer
    both = SideBySide({"all": observer, "each": observer.velocities})
    run = experiment("ball", {"o": both}).estimates["o"]
    each = run["each"]
    assert list(each) == ["qdot1", "qdot2"]
    value = jnp.concatenate([e.value for e in each.values()], axis=1)
    np.testing.assert_array_equal(value, run["all"].value)
    certificates = jnp.stack([e.certificate for e in each.values()])
    np.testing.assert_array_equal(certificates.min(axis=0), run["all"].certificate)
    # The ball's velocity is found from the beam's, and so worth no more.
    assert (certificates[0] <= certificates[1]).all()


number = st.floats(-1.0, 1.0)


class Sinusoids(eqx.Module):
    amplitudes: jax.Array

    def __call__(self, t):
        phases = jnp.arange(self.amplitudes.size)
        return self.amplitudes * jnp.sin((2.0 + phases) * t + phases)


def identity(system, form, start, amplitudes):
    """The errors at 20 ms and 1 s of the exact start, in motion under sinusoids."""
    observer = velocity_observer(system, FAST, form=form)
    ts = jnp.array([0.02, 1.0])
    open_loop = aslo.control.OpenLoop(Sinusoids(amplitudes))
    run = accurate(system, open_loop, {"o": observer}, start, ts)
    return run.error("o"), run.hidden


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 5.0), st.floats(0.5, 5.0), st.lists(number, min_size=8, max_size=8))
def test_the_identity_holds_for_any_leg(m1, m2, numbers):
    leg = RoboticLeg(m1, m2)
    q, v, u = np.split(np.array(numbers), [3, 6])
    start = state(q + np.array([2.5, 0, 0]), v)
    error, _ = identity(leg, structure_of(LEG), start, jnp.asarray(u))
    assert jnp.abs(error).max() < 1e-8


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 3.0), st.floats(1.0, 12.0), st.lists(number, min_size=5, max_size=5))
def test_the_identity_holds_for_any_ball(length, gravity, numbers):
    ball = BallBeam(length, gravity)
    q, v, u = np.split(np.array(numbers), [2, 4])
    error, v = identity(ball, structure_of(SYSTEMS["ball"]), state(q, v), jnp.asarray(u))
    assert jnp.abs(error).max() < 1e-8 * max(1.0, float(jnp.abs(v).max()))


def test_gradients_reach_masses_and_rate():
    t = jnp.arange(300) * 1e-3
    q = jnp.stack([1 + 0.3 * jnp.sin(2 * t), 0.4 + t, jnp.cos(t)], axis=1)
    u = jax.vmap(lambda q, t: held("leg", q, t))(q, t)
    form = structure_of(LEG)

    def loss(parameters):
        m1, m2, rate = parameters
        leg, filter = RoboticLeg(m1, m2), aslo.LowPass(rate)
        observer = velocity_observer(leg, filter, form=form)
        return jnp.mean(aslo.replay(observer, t, u, q).value[50:] ** 2)

    at = jnp.array([2.0, 3.0, 5.0])
    gradient = jax.jit(jax.grad(loss))(at)
    value = jax.jit(loss)
    for k in range(3):
        h = 1e-5 * jnp.zeros(3).at[k].set(1.0)
        slope = (value(at + h) - value(at - h)) / 2e-5
        np.testing.assert_allclose(gradient[k], slope, rtol=1e-5)
