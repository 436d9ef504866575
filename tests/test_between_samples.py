"""What currents do between the samples of a calibrated log: with held voltages, and with
smooth ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.tune._calibration.predict import RelationPrediction, turns
from aslo_jax.tune._calibration.profile import profile

R, L, MAGNET, SPEED, INTERVAL, ROWS = 0.31, 0.45e-3, 0.017, 420.0, 1e-4, 60


def signals(held):
    """u and y, and the mean of y over every interval but the last, all exact: currents that
    turn in a circle are sampled, and voltages lead from each to the next."""
    turning = lambda t: np.exp(1j * SPEED * t)
    current, magnet = (2.0 + 7.0j), MAGNET
    t = INTERVAL * np.arange(ROWS + 1)
    flux = (L * current + magnet) * turning(t)
    if held:  # phi' = u - rate phi + rate magnet turning(t)
        rate = R / L
        decay = np.exp(-rate * INTERVAL)
        forced = rate * magnet * turning(t[:-1]) / (rate + 1j * SPEED)
        forced = forced * (turning(INTERVAL) - decay)
        u = (flux[1:] - decay * flux[:-1] - forced) * rate / (1.0 - decay)
    else:
        mean = current * turning(t[:-1]) * (turning(INTERVAL) - 1) / (1j * SPEED * INTERVAL)
        u = np.diff(flux) / INTERVAL + R * mean
    mean = (u - np.diff(flux) / INTERVAL) / R
    pair = lambda z: np.stack([z.real, z.imag], axis=1)
    return pair(u), pair(current * turning(t[:-1])), pair(mean[:-1])


@pytest.mark.parametrize("held", [0.0, 1.0])
def test_the_mean_of_a_current_over_an_interval(held):
    """To fourth order in the angle of an interval, where the chord has an error of second
    order, of the voltage's kind."""
    u, y, mean = signals(held)
    relation = aslo.plants.FluxRelation(R, L, MAGNET)
    h = jnp.full(ROWS - 1, INTERVAL)

    def bend(held):
        prediction = RelationPrediction((relation,), jnp.zeros(1), held, (2,), (False,))
        each = turns(h, jnp.asarray(u), jnp.asarray(y))
        return np.asarray(jax.vmap(prediction.bend)(h, u[:-1], y[:-1], each))[2:-2]

    true = (mean - 0.5 * (y[1:] + y[:-1]))[2:-2]
    size = np.max(np.abs(true))
    np.testing.assert_allclose(bend(jnp.asarray(held)), true, atol=0.02 * size)
    assert np.max(np.abs(bend(jnp.asarray(1.0 - held)) - true)) > 0.5 * size


def test_no_end_is_looked_for_beyond_what_is_enough():
    """An interval that is no parabola, and wider, has no ends, at a few evaluations."""
    asked = []

    def evaluate(v):
        asked.append(v)
        return 1.5 * (v**2 - 1.0), 1.5 * np.diag(2.0 * v)

    arguments = (evaluate, np.ones(1), 0, 1.0, 1 / 3.0, 0.95, lambda v: 1.0, 9.0, 1)
    assert np.isfinite(profile(*arguments).low)
    whole = len(asked)
    found = profile(*arguments, enough=0.05)
    assert np.isinf(found.low) and np.isinf(found.high) and not found.parabolic
    assert len(asked) - whole < 0.5 * whole
