"""The verdict on positions that the inputs do not explain."""

import numpy as np
import pytest

from aslo_jax.diagnosis import Motion


def record(rows=3000, dt=2e-3, noise=2e-4, wrong=1.0):
    """A velocity that an observer finds, `wrong` times the true one, of a position."""
    t = dt * np.arange(rows)
    true = 3.0 * np.cos(2.0 * t) + np.sin(7.0 * t)
    q = 1.5 * np.sin(2.0 * t) + (1.0 - np.cos(7.0 * t)) / 7.0
    return t, q + noise * np.random.default_rng(2).normal(size=rows), wrong * true


def kinds(*piece, trusted=None):
    motion = Motion("qdot1")
    t = piece[0]
    motion.add(*piece, np.ones(t.size, bool) if trusted is None else trusted)
    return [warning.kind for warning in motion.diagnosis().warnings]


@pytest.mark.parametrize("wrong", [1.0, 0.8, 1.2])
def test_velocities_that_lead_along_are_right(wrong):
    assert kinds(*record(wrong=wrong)) == []


@pytest.mark.parametrize("wrong", [-1.0, 0.0, 3.0, 100.0])
def test_velocities_that_lead_away_are_named(wrong):
    assert kinds(*record(wrong=wrong)) == ["unexplained_motion"]


def test_the_noise_of_a_machine_at_rest_is_no_motion():
    t, q, velocity = record(noise=1e-3)
    still = 1e-3 * np.random.default_rng(4).normal(size=t.size)
    assert kinds(t, still, 0.0 * velocity) == []
    assert kinds(t, np.round(still, 3), 0.0 * velocity) == []
    assert kinds(t, 0.0 * q, 0.0 * velocity) == []


def test_velocities_that_coast_count_nothing():
    t, q, velocity = record()
    trusted = t > 2.0
    velocity[~trusted] = 50.0
    assert kinds(t, q, velocity, trusted=trusted) == []
    assert kinds(t, q, velocity) == ["unexplained_motion"]
