"""The interior PMSM: what dropping the d current costs, and the relation without that
cost."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import Prescribed, observe

import aslo_jax as aslo
from aslo_jax.observers import SelfConsistent
from aslo_jax.plants import InteriorPMSM

LQ = 40.03e-3


class Angle(eqx.Module):
    """Mechanical, at about `speed` (rad/s)."""

    speed: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, t):
        return self.speed * t + 0.5 * (1 - jnp.cos(t)) + 0.06


class Rippled(eqx.Module):
    """A d current that ripples at `frequency` (rad/s) by `ripple` (A)."""

    angle: Angle
    ripple: jax.Array = eqx.field(converter=jnp.asarray)
    frequency: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, t):
        theta = 5 * self.angle(t)
        d, q = -0.2 + self.ripple * jnp.sin(self.frequency * t), 1 + 0.3 * jnp.sin(3 * t)
        d_axis = jnp.stack([jnp.cos(theta), jnp.sin(theta)])
        q_axis = jnp.stack([-jnp.sin(theta), jnp.cos(theta)])
        return d * d_axis + q * q_axis


def motion(direct_inductance=LQ - 4e-3, ripple=1.0, frequency=9.0, speed=30.0):
    """A motor of the size of the paper's. Modules, not closures: compiled once for all."""
    motor = InteriorPMSM(8.875, direct_inductance, LQ, 0.2086, 5, 60e-6)
    angle = Angle(speed)
    return Prescribed(motor, angle, Rippled(angle, ripple, frequency))


def error(observer, motion, ts, **settings):
    estimate = observe(observer, motion.voltage, motion.current, ts, **settings)
    return jnp.linalg.norm(estimate.value - jax.vmap(motion.flux)(ts), axis=1)


@pytest.mark.slow
def test_without_the_d_current_the_error_is_linear_in_saliency_and_ripple():
    """2.8e-5 Wb for Ld - Lq = -0.5 mH to 2.2e-4 Wb for -4 mH with 1 A at 9 rad/s; nothing
    without saliency, or where the d current is constant."""
    ts = jnp.linspace(1.0, 2.0, 21)

    def largest(saliency, ripple):
        m = motion(LQ + saliency, ripple)
        observer = aslo.AlgebraicObserver(m.machine.flux_relation(), aslo.LowPass(50.0))
        return error(observer, m, ts, rtol=1e-9).max()

    cases = [(0.0, 1.0), (-0.5e-3, 1.0), (-4e-3, 1.0), (-4e-3, 0.5), (-4e-3, 0.0)]
    found = [largest(*case) for case in cases]
    np.testing.assert_allclose(found[1:3], [2.8e-5, 2.2e-4], rtol=0.1)
    np.testing.assert_allclose(found[3], found[2] / 2, rtol=0.02)
    assert found[0] < 1e-9 and found[4] < 1e-9


@pytest.mark.parametrize("ratio", [1.0, pytest.param(1.4, marks=pytest.mark.slow), 3.0])
def test_the_error_of_a_dropped_term_grows_with_the_ratio(ratio):
    m, ts = motion(LQ / ratio), jnp.linspace(1.0, 2.0, 21)
    observer = aslo.AlgebraicObserver(m.machine.flux_relation(), aslo.LowPass(50.0))
    expected = 0.055 * (LQ - LQ / ratio)  # Wb
    found = error(observer, m, ts, rtol=1e-9).max()
    assert abs(found - expected) < 0.25 * expected + 1e-9


def consistent(m, initial, rate=70.0, gain=50.0, **settings):
    relation = m.machine.self_consistent_relation()
    return SelfConsistent(relation, aslo.LowPass(rate), gain, initial, **settings)


@pytest.mark.slow
def test_with_its_own_d_current_the_flux_is_exact_after_a_second():
    """From no flux, from the opposite one, from seven times too much, to Lq/Ld = 3.3."""
    ts = jnp.array([0.05, 1.0, 1.5])
    ratios = (1.0, 1.5, 3.3, 3.3, 3.3)
    starts = jnp.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [-0.2, -0.1], [1.0, -1.0]])

    for ratio, initial in zip(ratios, starts, strict=True):
        m = motion(LQ / ratio)
        found = error(consistent(m, initial), m, ts, rtol=1e-10) / 0.2086
        assert found[1:].max() < 1e-8
        assert found[0] > 1e-2


def test_from_the_truth_it_stays_there():
    m = motion(LQ / 3.3)
    ts = jnp.array([0.05, 0.1, 0.5])
    truth = m.flux(jnp.zeros(()))
    assert error(consistent(m, truth), m, ts, rtol=1e-10).max() < 1e-9


@pytest.mark.parametrize("ratio", [pytest.param(1.5, marks=pytest.mark.slow), 3.3])
def test_a_start_that_is_forgotten_costs_no_more_than_the_saliency(ratio):
    """From the first certified instant on, to the truth at the rate of the filter; a start
    that is kept is left at the rate of the gain, from all of the flux."""
    m, ts = motion(LQ / ratio), jnp.array([0.02, 0.05, 0.1, 1.0, 1.5])

    def relative(forget):
        observer = consistent(m, jnp.zeros(2), forget=forget)
        return error(observer, m, ts, rtol=1e-10) / 0.2086

    forgotten, kept = relative(True), relative(False)
    saliency = (LQ - LQ / ratio) / 0.2086  # of an ampere, over the magnet's flux
    assert forgotten[:3].max() < 0.5 * saliency, forgotten
    assert kept[0] > 0.3
    assert forgotten[3:].max() < 1e-8


def log(m, dt, t1):
    t = jnp.arange(round(t1 / dt) + 1) * dt
    return t, *_signals(m, t, t + dt)


@eqx.filter_jit
def _signals(m, t, end):
    return jax.vmap(m.mean_voltage)(t, end), jax.vmap(m.current)(t)


@pytest.mark.parametrize("forget", [False, True])
def test_order_two_when_sampled(forget):
    m, errors = motion(LQ / 2), []
    for dt in (4e-4, 2e-4):
        t, u, y = log(m, dt, 5000 * dt)  # of one length: compiled once
        observer = consistent(m, jnp.zeros(2), forget=forget)
        value = aslo.replay(observer, t, u, y).value
        error = jnp.linalg.norm(value - jax.vmap(m.flux)(t), axis=1)
        errors.append(jnp.sqrt(jnp.mean(error[(t > 0.6) & (t <= 1.0)] ** 2)))
    # Of the flux that is fed back alone; the rows have none.
    assert errors[0] < 1e-7
    assert np.log2(errors[0] / errors[1]) > 1.9, errors


def test_a_start_that_is_forgotten_is_a_guess_until_then():
    """Sampled, with a guard: the guess while it coasts, then at once the flux."""
    m = motion(LQ / 1.5)
    t, u, y = log(m, 1e-4, 0.1)
    guess, guard = jnp.array([0.3, -0.4]), aslo.Guard(threshold=1e-3)
    found = {
        forget: aslo.replay(consistent(m, guess, forget=forget, guard=guard), t, u, y)
        for forget in (False, True)
    }
    first = int(jnp.argmin(found[True].coasting))
    assert 3 < first < 100
    truth = jax.vmap(m.flux)(t)
    error = jnp.linalg.norm(found[True].value - truth, axis=1) / 0.2086
    drift = jnp.linalg.norm(found[True].value[:first] - guess, axis=1)
    assert drift.max() < 0.3 and error[: first - 1].min() > 1.0
    assert error[first:].max() < 0.1
    kept = jnp.linalg.norm(found[False].value - truth, axis=1) / 0.2086
    assert kept[first] > 1.0


def test_the_active_flux_points_along_the_d_axis():
    m = motion()
    relation, t = m.machine.flux_relation(), jnp.linspace(0.0, 1.0, 7)
    x = relation.active_flux(jax.vmap(m.flux)(t), jax.vmap(m.current)(t))
    theta = 5 * m.angle(t)
    size = 0.2086 - 4e-3 * (-0.2 + jnp.sin(9 * t))
    expected = size[:, None] * jnp.stack([jnp.cos(theta), jnp.sin(theta)], axis=1)
    np.testing.assert_allclose(x, expected, atol=1e-12)


def test_a_control_loop_steps_and_has_gradients():
    m = motion()
    t, u, y = log(m, 1e-3, 0.15)
    observer = consistent(m, jnp.array([0.1, 0.0]))
    whole = aslo.replay(observer, t, u, y)
    state, step = observer.init(y[0], u[0]), eqx.filter_jit(observer.step)
    for k in range(1, len(t)):
        state, estimate = step(state, u[k - 1], y[k], 1e-3)
    np.testing.assert_allclose(estimate.value, whole.value[-1], rtol=1e-9)

    def loss(observer):
        return jnp.mean(aslo.replay(observer, t, u, y).value[50:] ** 2)

    gradient = eqx.filter_jit(eqx.filter_grad(loss))(observer)
    for leaf in jax.tree.leaves(eqx.filter(gradient.relation, eqx.is_array)):
        assert jnp.isfinite(leaf) and leaf != 0
    assert gradient.gain != 0 and gradient.filter.rate != 0
