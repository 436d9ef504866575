"""Smoothing over samples that are missing, and what the claimed deviations are worth."""

import functools

import equinox as eqx
import jax
import numpy as np
import pytest

import aslo_jax as aslo

R, L, M = 0.63, 2.1e-3, 0.037  # ohm, H, Wb
H, ROWS = 2e-4, 1200
CURRENT, VOLTAGE = 12e-3, 0.06  # A, V
OBSERVER = aslo.Lifted(aslo.plants.FluxRelation(R, L, M), CURRENT, VOLTAGE)
HOLE = slice(500, 560)  # a third of a turn at 180 rad/s


def turning(a):
    return np.stack([np.cos(a), np.sin(a)], axis=-1)


def log(speed, seed, rows=ROWS):
    """t, u, y and flux of a motor at constant speed (rad/s) with 3 A, 0.3 rad behind the q
    axis; its voltages are exact means."""
    rng = np.random.default_rng(seed)
    t, start = H * np.arange(rows), rng.uniform(0.0, 2.0 * np.pi)
    current = lambda t: 3.0 * turning(speed * t + start + 0.5 * np.pi - 0.3)
    flux = lambda t: M * turning(speed * t + start) + L * current(t)
    mean = current(t + 0.5 * H) * np.sinc(speed * H / 2.0 / np.pi)
    u = R * mean + (flux(t + H) - flux(t)) / H
    noise = lambda size: size * rng.standard_normal((rows, 2))
    return t, u + noise(VOLTAGE), current(t) + noise(CURRENT), flux(t)


@functools.cache
def smoother(missing):
    one = lambda t, u, y: aslo.smooth(OBSERVER, t, u, y, missing=missing)
    return eqx.filter_jit(jax.vmap(one, (None, 0, 0)))


def squares(found, flux):
    """The squared errors in units of the covariance, over the size of x."""
    e, P = np.asarray(found.value) - flux, np.asarray(found.covariance)
    return np.sum(e * np.linalg.solve(P, e[..., None])[..., 0], axis=-1) / 2.0


def test_without_a_hole_nothing_changes():
    t, u, y, _ = log(180.0, 1, 300)
    found = [smoother(missing)(t, u[None], y[None]) for missing in ("refuse", "coast")]
    np.testing.assert_allclose(found[1].value, found[0].value, rtol=0, atol=1e-11 * M)
    np.testing.assert_allclose(
        np.asarray(found[1].covariance), np.asarray(found[0].covariance), rtol=1e-7
    )
    assert not found[1].coasting.any()


def test_a_hole_is_known_from_both_sides():
    logs = [log(180.0, seed) for seed in range(10, 22)]
    t, (u, y, flux) = logs[0][0], (np.stack([x[k] for x in logs]) for k in (1, 2, 3))
    u[:, HOLE] = y[:, HOLE] = np.nan
    found = smoother("coast")(t, u, y)
    forward = jax.vmap(
        lambda u, y: aslo.replay(OBSERVER, t, u, y, missing="coast", engine="scan")
    )(u, y)
    # The interval before a row is missing too where its u is.
    lost = np.zeros(ROWS, bool)
    lost[HOLE.start : HOLE.stop + 1] = True
    np.testing.assert_array_equal(found.coasting, np.broadcast_to(lost, (12, ROWS)))
    size = lambda x, rows: np.sqrt(np.mean(np.sum((x - flux)[:, rows] ** 2, axis=2)))
    late = slice(HOLE.stop - 20, HOLE.stop + 100)
    assert size(found.value, late) < 0.6 * size(forward.value, late)
    claim = np.trace(np.asarray(found.covariance), axis1=2, axis2=3)
    middle = (HOLE.start + HOLE.stop) // 2
    assert (claim[:, middle] > 10 * claim[:, HOLE.start - 20]).all()
    assert (claim[:, middle] > claim[:, HOLE.stop]).all()
    every = squares(found, flux)
    assert np.isfinite(every).all()
    assert every[:, ~lost].mean() < 1.5 and every[:, lost].mean() < 2.0


def test_rows_before_a_hole_in_which_all_is_lost_are_a_log_of_their_own():
    t, u, y, flux = log(180.0, 30, 900)
    first = 700
    u[150:first] = y[150:first] = np.nan
    whole = smoother("coast")(t, u[None], y[None])
    late = slice(first + 10, None)
    assert squares(whole, flux)[0, late].mean() < 2.0
    before = smoother("coast")(t[:150], u[None, :150], y[None, :150])
    # The first held samples, before all is lost, still count for next to nothing.
    claim = np.trace(np.asarray(before.covariance)[0, :140], axis1=1, axis2=2)
    apart = np.sum((whole.value[0, :140] - before.value[0, :140]) ** 2, axis=1)
    assert (apart < 1e-4 * claim).all()
    assert whole.coasting[0, 150:first].all() and not whole.coasting[0, late].any()


def test_a_log_that_begins_with_a_hole_and_one_that_is_filled():
    t, u, y, flux = log(180.0, 40, 300)
    u[:30] = y[:30] = np.nan
    u[200] = y[200, 1] = np.nan
    found = smoother("coast")(t, u[None], y[None])
    assert found.coasting[0, :30].all() and found.coasting[0, 200]
    assert np.isfinite(found.value).all()
    assert np.linalg.norm(found.value[0, 35:] - flux[35:], axis=1).max() < 0.05 * M
    filled = smoother("interpolate")(t, u[None], y[None])
    assert not filled.coasting[0, 200]
    with pytest.raises(ValueError, match="must be finite"):
        aslo.smooth(OBSERVER, t, u, y)
    with pytest.raises(ValueError, match="Argument `missing` must be"):
        aslo.smooth(OBSERVER, t, u, y, missing="drop")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("speed", "seeds"), [(40.0, 16), pytest.param(40.0, 200, marks=pytest.mark.slow)]
)
def test_its_covariance_is_that_of_its_error(speed, seeds):
    """Pooled over rows and seeds, with the start of the log in it."""
    logs = [log(speed, seed) for seed in range(100, 100 + seeds)]
    t, (u, y, flux) = logs[0][0], (np.stack([x[k] for x in logs]) for k in (1, 2, 3))
    every = squares(smoother("refuse")(t, u, y), flux)
    print("NEES", every.mean(), every[:, :100].mean(), every[:, 500:700].mean())
    assert 0.7 < every.mean() < 1.4
