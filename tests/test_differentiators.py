"""Differentiators: closed forms, and naive oracles of their sampled laws."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from mechanisms import STARTS, SYSTEMS, Held

import aslo_jax as aslo
from aslo_jax.disturbances import Encoder
from aslo_jax.observers import (
    ExtendedKalman,
    FilteredDerivative,
    HighGain,
    SuperTwisting,
    velocity_observer,
)

DT = 1e-3
T = np.arange(2001) * DT
Q = np.stack([np.sin(2 * T), 0.3 * np.cos(3 * T) + T], axis=1)
V = np.stack([2 * np.cos(2 * T), -0.9 * np.sin(3 * T) + 1], axis=1)
U = np.zeros((T.size, 2))


def test_the_filtered_derivative_against_scipy():
    """p lam/(p + lam) of a signal that is a line between samples."""
    found = aslo.replay(FilteredDerivative(aslo.LowPass(40.0)), T, U, Q).value
    for j in range(2):
        _, expected, _ = scipy.signal.lsim(
            scipy.signal.lti([40.0, 0.0], [1.0, 40.0]), Q[:, j] - Q[0, j], T
        )
        np.testing.assert_allclose(found[:, j], expected, atol=1e-10)


def test_the_high_gain_observer_against_scipy():
    w = np.array([30.0, 50.0])
    found = aslo.replay(HighGain(w), T, U, Q).value
    for j in range(2):
        system = scipy.signal.lti([w[j] ** 2, 0.0], [1.0, 2 * w[j], w[j] ** 2])
        _, expected, _ = scipy.signal.lsim(system, Q[:, j] - Q[0, j], T)
        np.testing.assert_allclose(found[:, j], expected, atol=1e-9)


def test_the_high_gain_observer_lags_by_twice_the_acceleration_over_its_bandwidth():
    q = 0.5 * 3.0 * T[:, None] ** 2
    found = aslo.replay(HighGain(40.0), T, 0 * T[:, None], q).value[-1, 0]
    np.testing.assert_allclose(found - 3.0 * T[-1], -2 * 3.0 / 40.0, rtol=1e-6)


def test_the_high_gain_observer_with_the_model_does_not_lag():
    observers = {
        "model": HighGain(40.0, SYSTEMS["leg"]),
        "none": HighGain(40.0),
        "ASLO": velocity_observer(SYSTEMS["leg"], aslo.LowPass(10.0)),
    }
    leg, start = SYSTEMS["leg"], STARTS["leg"]
    run = aslo.Experiment(leg, Held("leg"), observers, DT, initial=start).run(3000)
    error = {k: np.abs(e.value - run.hidden)[1500:].max() for k, e in run.estimates.items()}
    assert error["model"] < 0.01 * error["none"]
    assert error["ASLO"] < 1e-4 < error["none"]


def test_the_super_twisting_law_solves_its_implicit_equations():
    """`x1+ = x1 + h (x2 + 1.1 L h s) + 1.5 h sqrt(L |e+|) s`, `x2+ = x2 + 1.1 L h s` with s
    in sign(e+), e+ = q+ - x1+: checked from the states alone, away from and at e+ = 0."""
    L, h = 12.0, 0.01
    rng = np.random.default_rng(3)
    t = np.arange(120) * h
    q = np.sin(3 * t) + 0.002 * rng.normal(size=t.size) * (t > 0.6)
    states, observer = [], SuperTwisting(L)
    state = observer.init(jnp.asarray(q[:1]), jnp.zeros(1))
    states.append(np.asarray(state.states["position_velocity"])[:, 0])
    for k in range(1, t.size):
        state, _ = observer.step(state, jnp.zeros(1), jnp.asarray(q[k : k + 1]), h)
        states.append(np.asarray(state.states["position_velocity"])[:, 0])
    x, inside = np.array(states), 0
    for k in range(1, t.size):
        s = (x[k, 1] - x[k - 1, 1]) / (1.1 * L * h)
        e = q[k] - x[k, 0]
        moved = h * (x[k - 1, 1] + 1.1 * L * h * s) + 1.5 * h * np.sqrt(L * abs(e)) * s
        np.testing.assert_allclose(x[k, 0] - x[k - 1, 0], moved, atol=1e-12)
        if abs(e) < 1e-13:
            assert abs(s) <= 1 + 1e-9
            inside += 1
        else:
            np.testing.assert_allclose(s, np.sign(e), atol=1e-9)
    assert 10 < inside < t.size - 10


def test_the_super_twisting_differentiator_is_exact_after_a_finite_time():
    found = aslo.replay(SuperTwisting([6.0, 4.0]), T, U, Q).value
    assert np.abs(found - V)[1000:].max() < 5e-3  # half a step of acceleration
    slow = aslo.replay(SuperTwisting([3.0, 4.0]), T, U, Q).value  # |q1''| reaches 4
    assert np.abs(slow - V)[1000:, 0].max() > 0.05


def test_the_super_twisting_law_in_continuous_time():
    observer = SuperTwisting(8.0)
    state = observer.init(jnp.array([0.3, 1.0]), jnp.zeros(2))
    y = jnp.array([0.5, 0.7])
    rate = observer.vector_field(jnp.zeros(()), state, jnp.zeros(2), y)
    expected = [
        [1.5 * np.sqrt(8.0 * 0.2), -1.5 * np.sqrt(8.0 * 0.3)],
        [1.1 * 8.0, -1.1 * 8.0],
    ]
    np.testing.assert_allclose(rate.states["position_velocity"], expected, rtol=1e-12)


@pytest.mark.slow
def test_the_extended_kalman_filter_of_a_mechanism():
    leg, start = SYSTEMS["leg"], STARTS["leg"]
    ekf = ExtendedKalman.of_mechanical(leg, 1.0, 1e-8, initial=start.position)
    run = aslo.Experiment(leg, Held("leg"), {"e": ekf}, DT, initial=start).run(1000)
    error = run.estimates["e"].value - run.hidden
    assert jnp.abs(error[0]).max() > 0.4
    assert jnp.abs(error[200:]).max() < 1e-9


def test_an_encoder_rounds_and_wraps():
    encoder = Encoder([0.1, 2 * np.pi / 4096], (False, True))
    y = jnp.array([0.26, -0.001])
    found = encoder(jnp.zeros(()), None, y)
    np.testing.assert_allclose(found, [0.3, 2 * np.pi * 4095 / 4096], rtol=1e-12)
    plain = Encoder([0.1, 0.5])(jnp.zeros(()), None, jnp.array([-0.26, 7.3]))
    np.testing.assert_allclose(plain, [-0.3, 7.5], rtol=1e-12)
    full = encoder(jnp.zeros(()), None, jnp.array([0.0, 2 * np.pi]))
    np.testing.assert_allclose(full, [0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HighGain(0.0), r"`bandwidth` must be positive and finite \(rad/s\)"),
        (lambda: SuperTwisting([1.0, -1.0]), "`bound` must be positive and finite"),
        (lambda: Encoder([0.0]), "`resolution` must be positive and finite"),
    ],
)
def test_settings_out_of_range_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
