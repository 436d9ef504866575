"""Tracking controllers of mechanisms, on measured and on estimated velocities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import STARTS, SYSTEMS, state

import aslo_jax as aslo
from aslo_jax.control import BallBeamTracking, MechanicalFeedback, Tracking
from aslo_jax.observers import velocity_observer


def sway(t):
    return jnp.stack([1.0 + 0.2 * jnp.sin(t), 0.6 * jnp.sin(1.3 * t)])


LOOPS = {
    "leg": Tracking(SYSTEMS["leg"], sway, (0, 1), 4.0),
    "cart": Tracking(SYSTEMS["cart"], lambda t: sway(t) - jnp.array([0.4, 0.0]), (0, 1)),
    "pendulum": Tracking(SYSTEMS["pendulum"], lambda t: sway(t)[:1] + 0.1, (0,), 5.0),
    "wheel": Tracking(SYSTEMS["wheel"], lambda t: 2.0 * sway(t)[1:], (1,), 4.0),
    "ball": BallBeamTracking(SYSTEMS["ball"], lambda t: 0.2 * jnp.sin(0.5 * t)),
}
TRACKED = {"leg": [0, 1], "cart": [0, 1], "pendulum": [0], "wheel": [1], "ball": [0]}


def wanted(name, t):
    controller = LOOPS[name]
    return np.asarray(jax.vmap(controller.reference)(t)).reshape(t.size, -1)


def run(name, feedback, seconds=8.0):
    observer = velocity_observer(SYSTEMS[name], aslo.LowPass(20.0))
    loop = aslo.Experiment(
        SYSTEMS[name],
        LOOPS[name],
        {"ASLO": observer},
        1e-3,
        feedback=feedback,
        initial=STARTS[name],
    )
    return loop.run(round(seconds * 1000), 10)


def measured(y, x, estimates):
    return MechanicalFeedback(y, x.velocity)


def estimated(y, x, estimates):
    return MechanicalFeedback(y, estimates["ASLO"].value)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "leg")) for n in LOOPS]
)
def test_the_loop_follows_with_measured_and_with_estimated_velocity(name):
    found = {}
    for feedback in (measured, estimated):
        result = run(name, feedback)
        reference = wanted(name, result.t)
        error = np.asarray(result.x.position)[:, TRACKED[name]] - reference
        found[feedback] = error
        late = np.abs(error[result.t > 5.0]).max()
        # The ball's beam is a lag that the outer loop does not know of.
        assert late < (0.05 if name == "ball" else 5e-3)
        assert np.abs(error[0]).max() > 0.01
        assert np.abs(result.x.position).max() < 12.0
    close = 0.03 * max(np.abs(found[measured]).max(), 0.1)
    assert np.abs(found[measured] - found[estimated]).max() < close


def simulated(observers, **settings):
    """The leg in continuous time, compiled as a whole."""
    run = lambda: aslo.simulate(SYSTEMS["leg"], LOOPS["leg"], observers, **settings)
    return jax.jit(run)()


def test_the_error_decays_as_designed():
    """`e'' + 2 w e' + w^2 e = 0` in continuous time, whatever the third coordinate does."""
    w, start = 4.0, state([1.3, -0.2, 0.4], [0.1, 0.5, -0.3])
    ts = jnp.array([0.0, 0.2, 0.7, 1.5])
    result = simulated({}, t1=1.5, ts=ts, initial=start, feedback=measured)
    error = wanted("leg", ts) - np.asarray(result.x.position)[:, :2]
    speed = np.array([0.2, 0.78]) - np.array([0.1, 0.5])
    for j in range(2):
        e0, t = error[0, j], np.asarray(ts)
        expected = (e0 + (speed[j] + w * e0) * t) * np.exp(-w * t)
        np.testing.assert_allclose(error[:, j], expected, atol=1e-6)


def test_fewer_inputs_than_coordinates_need_estimates_before_an_input():
    """The leg has three coordinates and two inputs: both loops know the shape of u."""
    observer = velocity_observer(SYSTEMS["leg"], aslo.LowPass(20.0))
    result = simulated(
        {"ASLO": observer}, t1=4.0, initial=STARTS["leg"], feedback=estimated
    )
    assert result.u.shape == (1001, 2)
    error = wanted("leg", result.t) - np.asarray(result.x.position)[:, :2]
    assert np.abs(error[-1]).max() < 1e-3
