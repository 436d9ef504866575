"""Disturbances in a closed loop against plain Python, in both engines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plain_disturbances import CASES, LANES, STARTS, STEPS, A, Case, H, K, Plain, loop

import aslo_jax as aslo

pytest.importorskip("llvmlite")


SCALES = np.array([[1.0, 0.7, 1.3], [0.9, 1.2, 0.8], [1.1, 0.6, 0.5]])  # by lane and place
PLACES = "actuator", "sensor", "input_sensor"


def key_of(lane):
    return aslo.random.fold(aslo.random.key(7), lane)


def written_out(case, lane):
    """The same loop in plain Python: Runge-Kutta's fourth-order step, nothing else."""
    key = key_of(lane)
    actuator, sensor, input_sensor = (
        case.plain(key, n, a) for n, a in enumerate(SCALES[lane])
    )
    x, rows = STARTS[lane], []
    for k in range(STEPS + 1):
        t = k * H
        y = sensor.at(k, t, x, x)
        command = np.array([np.sin(3 * t), 0.5 * np.cos(2 * t)]) - K * y
        rows.append([x, y, input_sensor.at(k, t, command, x)])

        def rate(at, z, k=k, command=command):
            return A @ z + actuator.at(k, at, command, z)

        k1 = rate(t, x)
        k2 = rate(t + H / 2, x + H / 2 * k1)
        k3 = rate(t + H / 2, x + H / 2 * k2)
        k4 = rate(t + H * (1 - 1e-9), x + H * k3)
        for part, s in ((actuator, command), (sensor, x), (input_sensor, command)):
            part.sample(k, t, s, x)
        x = x + H / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(rows)


@pytest.mark.parametrize("name", CASES)
def test_a_closed_loop_written_out(name):
    """Actuator, sensor and the observers' input disturbed at once, three lanes, against
    plain Python; the fused engine as `scan`."""
    case = CASES[name]

    def make(sample):
        x, scales, key = sample
        parts = [case.make(key, n, scales[n]) for n in range(3)]
        return loop(x, **dict(zip(PLACES, parts, strict=True)))

    samples = jnp.asarray(STARTS), jnp.asarray(SCALES), jax.vmap(key_of)(jnp.arange(LANES))
    scan, fused = (
        aslo.run_batch(
            make, samples, STEPS, record=lambda r: (r.x, r.y, r.u), every=1, engine=engine
        ).record
        for engine in ("scan", "fused")
    )
    for a, b in zip(scan, fused, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12)
    for lane in range(LANES):
        expected = written_out(case, lane)
        found = np.stack([np.asarray(part)[lane] for part in scan], axis=1)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
    undisturbed = written_out(Case(None, lambda *_: Plain(lambda t, s: s)), 0)
    assert all(np.abs(written_out(case, 0) - undisturbed).max(axis=(0, 2)) > 1e-3)
