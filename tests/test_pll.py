"""The phase-locked loop: in step from the second sample on, and honest where it is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM

import aslo_jax as aslo
from aslo_jax.observers._pll import lagless

DT = 1e-4


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("speed", [-7000.0, 3.0, 6000.0])
@pytest.mark.parametrize("bandwidth", [53.0, 4100.0])
def test_a_constant_speed_is_found_at_once(speed, bandwidth):
    t = np.arange(400) * DT
    y = wrapped(2.0 + speed * t)
    found = aslo.replay(aslo.PhaseLockedLoop(bandwidth), t, 0 * y, y)
    np.testing.assert_allclose(found.value[1:, 1], speed, rtol=1e-9)
    np.testing.assert_array_equal(found.coasting, t * bandwidth < 1.0)


def test_settled_its_poles_are_at_minus_the_bandwidth():
    t, b = np.arange(4000) * DT, 80.0
    y = np.where(t > 0.3, 0.2, 0.0)  # a step of the angle
    speed = aslo.replay(aslo.PhaseLockedLoop(b), t, 0 * y, y).value[:, 1]
    after = t[3001:] - 0.3
    np.testing.assert_allclose(
        speed[3001:], 0.2 * b * b * after * np.exp(-b * after), atol=0.02 * 0.2 * b
    )


def test_the_lag_under_acceleration_is_removed():
    t, b, acceleration = np.arange(8000) * DT, 90.0, 500.0
    y = 0.5 * acceleration * t**2
    loop = aslo.PhaseLockedLoop(b, wraps=False)
    angle, speed = aslo.replay(loop, t, 0 * y, y).value.T
    behind = acceleration * t - speed
    np.testing.assert_allclose(behind[-1], 2 * acceleration / b, rtol=0.02)
    corrected = speed + lagless(b, np.full(t.size, DT)) * (y - angle)
    np.testing.assert_allclose(corrected[-1], acceleration * t[-1], rtol=1e-9)


def test_the_start_is_a_line_fitted_by_least_squares():
    t = np.arange(60) * DT
    y = 900.0 * t + 0.02 * np.random.default_rng(1).normal(size=t.size)
    found = aslo.replay(aslo.PhaseLockedLoop(5.0), t, 0 * y, y).value
    for k in (2, 10, 59):
        slope, at_end = np.polyfit(t[: k + 1] - t[k], y[: k + 1], 1)
        np.testing.assert_allclose(found[k], [at_end, slope], rtol=1e-9)


def test_a_loop_that_does_not_follow_says_so():
    t = np.arange(3000) * DT
    y = np.where(t < 0.1, 100.0 * t, 10.0 + 100.0 * (t - 0.1) + 4e5 * (t - 0.1) ** 2)
    loop = aslo.PhaseLockedLoop(60.0, wraps=False)
    found = aslo.replay(loop, t, 0 * y, y)
    away = np.abs(y - found.value[:, 0]) > 1.0
    assert away.any() and found.coasting[away].all()
    assert not found.coasting[(t > 0.02) & ~away].any()


def test_the_loop_waits_for_the_stage_before_it():
    """The angle of a first guess is no angle."""
    motor = PrescribedPMSM(0.9, 3e-3, 0.05, 4)
    row = lambda t: (motor.mean_voltage(t, t + 1e-3), motor.current(t))
    t = np.arange(500) * 1e-3
    u, y = map(np.asarray, jax.vmap(row)(jnp.asarray(t)))
    flux = aslo.AlgebraicObserver(
        motor.relation(), aslo.LowPass(25.0), guard=aslo.Guard(1e-2)
    )
    made = aslo.observers.track_angle(flux, 60.0, motor.inductance)
    found = aslo.replay(made, t, u, y)
    first, second = found["first"], found["second"]
    assert first.coasting[:3].all() and second.coasting[first.coasting].all()
    right = np.abs(second.value[:, 1] - 4 * (2 + 0.5 * np.sin(t)))
    assert right[~second.coasting].max() < 1.0
