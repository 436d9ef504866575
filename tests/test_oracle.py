"""The library against a loop that anyone can check by eye."""

from importlib.resources import files

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import replay_cascade, replay_loop

import aslo_jax as aslo

RESISTANCE, INDUCTANCE, RATE = 8.875, 40.03e-3, 20.0
SETTINGS = {"resistance": RESISTANCE, "inductance": INDUCTANCE, "lam": RATE}


@pytest.fixture(scope="module")
def log():
    path = str(files("aslo_jax") / "data" / "pmsm_log.csv")
    t, *columns = np.loadtxt(path, delimiter=",", skiprows=1, max_rows=1000).T
    return t, np.stack(columns[:2], axis=1), np.stack(columns[2:4], axis=1)


@pytest.fixture
def observer():
    # The magnet flux is a constant that drops out, and the oracle does without it.
    relation = aslo.plants.FluxRelation(RESISTANCE, INDUCTANCE)
    return aslo.AlgebraicObserver(relation, aslo.LowPass(RATE))


def assert_equal_to_rounding(flux, expected, certificate):
    """Equal to 1e-12 of the flux, and near t = 0 to what rounding leaves: the solution
    has an error of machine epsilon over the reciprocal condition number."""
    size = np.abs(expected).max()
    allowed = 1e-12 + 4 * np.finfo(float).eps / certificate
    np.testing.assert_array_less(np.abs(flux - expected).max(axis=1) / size, allowed)


def uneven(t):
    """The same instants, each moved by up to a third of an interval."""
    jitter = np.random.default_rng(7).uniform(-1.0, 1.0, t.size)
    return t + jitter * np.diff(t).min() / 3


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("instants", [np.asarray, uneven])
def test_replay_is_the_loop(log, observer, substeps, instants):
    t, u, y = log
    t = instants(t)
    loop = replay_loop(t, u, y, **SETTINGS, substeps=substeps)
    estimate = aslo.replay(observer, t, u, y, substeps=substeps)
    np.testing.assert_array_equal(estimate.coasting, loop.coasting)
    certified = ~loop.coasting
    assert certified.mean() > 0.99
    np.testing.assert_allclose(
        estimate.certificate[certified], loop.certificate[certified], rtol=1e-9
    )
    assert_equal_to_rounding(
        estimate.value[certified], loop.flux[certified], loop.certificate[certified]
    )
    settled = t > 0.05
    np.testing.assert_allclose(
        estimate.value[settled], loop.flux[settled], atol=1e-12 * np.abs(loop.flux).max()
    )


def test_loop_coasts_where_the_guard_does(log, observer):
    t, u, y = log
    guard = aslo.Guard(threshold=1e-3)
    observer = aslo.AlgebraicObserver(
        observer.relation, observer.filter, guard=guard, initial=jnp.zeros(2)
    )
    loop = replay_loop(t, u, y, **SETTINGS, threshold=1e-3)
    estimate = aslo.replay(observer, t, u, y)
    assert loop.coasting.sum() > 5
    np.testing.assert_array_equal(estimate.coasting, loop.coasting)
    np.testing.assert_allclose(
        estimate.value[loop.coasting], loop.flux[loop.coasting], rtol=0, atol=1e-12
    )


def test_cascade_is_the_loop(log):
    t, u, y = log
    loop = replay_loop(t, u, y, **SETTINGS)
    flux = replay_cascade(t, u, y, **SETTINGS)
    certified = ~loop.coasting
    assert_equal_to_rounding(
        flux[certified], loop.flux[certified], loop.certificate[certified]
    )
