"""Gradients of a loss in the filter's rate and the gain, forward and reverse, against
central differences."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM

import aslo_jax as aslo

MOTOR = PrescribedPMSM()


def observer(gains, **settings):
    rate, gain = gains
    inner = aslo.AlgebraicObserver(
        MOTOR.relation(), aslo.LowPass(rate), aslo.Repeat(), **settings
    )
    return aslo.Asymptotic(inner, gain, initial=jnp.array([0.3, -0.1]))


def replay_loss(gains):
    t = np.arange(800) * 5e-4
    y = jax.vmap(MOTOR.current)(jnp.asarray(t))
    u = jax.vmap(MOTOR.voltage)(jnp.asarray(t + 2.5e-4))
    value = aslo.replay(observer(gains, start="paper"), t, u, y, substeps=2).value
    return 100 * jnp.mean((value - jax.vmap(MOTOR.flux)(jnp.asarray(t))) ** 2)


def simulate_loss(gains, adjoint=None, fixed=False):
    plant = aslo.plants.IntegratorChain(2)
    rate, gain = gains
    inner = aslo.AlgebraicObserver(
        plant.relation(), aslo.LowPass(rate), aslo.Repeat(), start="paper"
    )
    steps = (
        dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=1e-2)
        if fixed
        else dict(stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-12))
    )
    solution = aslo.simulate(
        plant,
        lambda t: jnp.cos(2 * t),
        {"A": aslo.Asymptotic(inner, gain, initial=jnp.zeros(1))},
        t1=2.0,
        initial=jnp.array([0.2, 0.7]),
        solver=diffrax.Dopri8(),
        adjoint=adjoint,
        **steps,
    )
    return jnp.mean(solution.error("A") ** 2)


def reverse(loss):
    """Value and gradient: one program for both, and for the differences."""
    return jax.jit(jax.value_and_grad(loss))


def forward(loss):
    return jax.jit(jax.jacfwd(loss))


def central(both, at, step=1e-4):
    """Differences of the value that [`reverse`][] returns, in every entry of `at`."""
    steps = jnp.diag(step * jnp.ravel(at)).reshape(-1, *jnp.shape(at))
    return jnp.stack(
        [(both(at + d)[0] - both(at - d)[0]) / (2 * jnp.sum(d)) for d in steps]
    ).reshape(jnp.shape(at))


GAINS = jnp.array([6.0, 2.5])


def test_replay():
    both = reverse(replay_loss)
    expected = central(both, GAINS)
    assert jnp.abs(expected).min() > 1e-4
    np.testing.assert_allclose(forward(replay_loss)(GAINS), expected, rtol=1e-5)
    np.testing.assert_allclose(both(GAINS)[1], expected, rtol=1e-5)


def closed_form(gains):
    """e' = -gain e + gain e_alg with e_alg = (rate y0 - x20) exp(-rate t)."""
    rate, gain = gains
    t = jnp.linspace(0.0, 2.0, 1001)
    amplitude = rate * 0.2 - 0.7
    forced = gain * (jnp.exp(-rate * t) - jnp.exp(-gain * t)) / (gain - rate)
    return jnp.mean((-0.7 * jnp.exp(-gain * t) + amplitude * forced) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [False, True], ids=["adaptive", "fixed"])
def test_simulate(fixed):
    both = reverse(lambda g: simulate_loss(g, None, fixed))
    expected = central(both, GAINS)
    assert jnp.abs(expected).min() > 1e-4
    found = forward(lambda g: simulate_loss(g, diffrax.ForwardMode(), fixed))(GAINS)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    value, gradient = both(GAINS)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5)
    if not fixed:
        np.testing.assert_allclose(value, closed_form(GAINS), rtol=1e-8)
        np.testing.assert_allclose(gradient, jax.grad(closed_form)(GAINS), rtol=1e-6)


def test_replay_gradients_reach_the_relation():
    """The gradient in the resistance, through filters, completion and guard."""
    t = np.arange(600) * 5e-4
    y = jax.vmap(MOTOR.current)(jnp.asarray(t))
    u = jax.vmap(MOTOR.voltage)(jnp.asarray(t + 2.5e-4))

    def loss(resistance):
        relation = aslo.plants.FluxRelation(resistance, MOTOR.inductance)
        ls = aslo.AlgebraicObserver(relation, aslo.LowPass(20.0))
        value = aslo.replay(ls, t, u, y).value
        return jnp.mean((value - jax.vmap(MOTOR.flux)(jnp.asarray(t)))[200:] ** 2)

    R, both = jnp.asarray(9.3), reverse(loss)
    expected = central(both, R, 1e-5)
    np.testing.assert_allclose(both(R)[1], expected, rtol=1e-5)
    np.testing.assert_allclose(forward(loss)(R), expected, rtol=1e-5)


def test_gradient_through_steps():
    def loss(rate):
        ls = eqx.tree_at(lambda o: o.filter.rate, observer((3.0, 1.0)).observer, rate)
        state = ls.init(jnp.array([0.1, 0.2]), jnp.zeros(2))
        for k in range(1, 5):  # of no motor, since with exact rows no rate matters
            y = jnp.array([jnp.cos(0.3 * k), jnp.sin(0.4 * k)])
            state, estimate = ls.step(state, jnp.array([1.0, 2.0]), y, 0.05)
        return jnp.sum(estimate.value)

    rate, both = jnp.asarray(3.0), reverse(loss)
    np.testing.assert_allclose(both(rate)[1], central(both, rate, 3e-6), rtol=1e-5)
