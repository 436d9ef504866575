"""Smoothing with unknown parameters: what the claimed deviations are worth."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_smooth_holes import CURRENT, VOLTAGE, H, L, M, R, turning

import aslo_jax as aslo

ROWS, OFF = 1500, np.array([0.12, -0.02])


def log(seed, rows=ROWS):
    """t, u, y and flux of a motor whose speed and current vary; currents are linear in
    between."""
    rng = np.random.default_rng(seed)
    t = 0.5 * H * np.arange(2 * rows - 1)
    angle = rng.uniform(0.0, 2.0 * np.pi) + 90.0 * t - 4.0 * np.cos(11.0 * t)
    current = (2.0 + 1.2 * np.sin(17.0 * t))[:, None] * turning(angle + 0.5 * np.pi - 0.3)
    flux = (M * turning(angle) + L * current)[::2]
    u = np.diff(flux, axis=0) / H
    u = u + R / 6.0 * (current[:-2:2] + 4.0 * current[1::2] + current[2::2])
    u = np.append(u, u[-1:], axis=0)
    noise = lambda size: size * rng.standard_normal((rows, 2))
    return t[::2], u + noise(VOLTAGE), current[::2] + noise(CURRENT), flux


def observer(**settings):
    relation = aslo.plants.FluxRelation((1 + OFF[0]) * R, L, (1 + OFF[1]) * M)
    return aslo.Adaptive(relation, CURRENT, VOLTAGE, bank=5, **settings)


def logs(seeds):
    every = [log(seed) for seed in seeds]
    return every[0][0], *(np.stack([x[k] for x in every]) for k in (1, 2, 3))


def smoothed(t, u, y, missing="refuse"):
    """Of each log."""
    one = lambda log: aslo.smooth(observer(), t, *log, missing=missing)
    every = [one(log) for log in zip(u, y, strict=True)]
    return jax.tree.map(lambda *x: np.stack(x), *every)


def squares(e, P):
    """The squared errors in units of their covariance, over their size."""
    return np.sum(e * np.linalg.solve(P, e[..., None])[..., 0], axis=-1) / e.shape[-1]


@pytest.mark.parametrize("seeds", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_its_covariance_is_that_of_its_error_from_the_first_row_on(seeds):
    t, u, y, flux = logs(range(seeds))
    found = smoothed(t, u, y)
    assert not found.coasting.any()
    of_x = squares(np.asarray(found.value) - flux, np.asarray(found.covariance))
    off = np.asarray(found.parameters)[:, 0] - np.array([R, M])
    P = np.asarray(found.parameter_covariance)[:, 0]
    print("NEES", of_x[:, :20].mean(), of_x.mean(), squares(off, P).mean())
    spread = 1.0 / np.sqrt(seeds)  # of a mean over the seeds
    assert abs(of_x[:, :20].mean() - 1.0) < 3.0 * spread
    assert abs(of_x[:, 20:].mean() - 1.0) < 0.3
    assert abs(squares(off, P).mean() - 1.0) < 3.0 * spread


def test_it_is_better_than_the_filter_and_knows_the_start():
    t, u, y, flux = logs(range(200, 208))
    found = smoothed(t, u, y)
    forward = eqx.filter_jit(jax.vmap(lambda u, y: aslo.replay(observer(), t, u, y)))(u, y)
    size = lambda x, rows: np.sqrt(np.mean(np.sum((x - flux)[:, rows] ** 2, axis=2)))
    middle = slice(700, ROWS - 200)
    assert size(found.value, middle) < size(forward.value, middle) / 1.2
    assert np.asarray(forward.coasting)[:, 0].all()
    assert size(found.value, slice(50)) < 0.02 * M
    np.testing.assert_array_equal(found.parameters[:, 0], found.parameters[:, -1])
    np.testing.assert_allclose(
        found.parameters[:, -1], forward.parameters[:, -1], rtol=1e-2
    )


def test_what_is_not_known_of_the_parameters_is_in_the_covariance():
    """Along the change of the smoothed state with the resistance; the magnet flux drops
    out."""
    t, u, y, _ = (x[0] if np.ndim(x) == 3 else x for x in logs([300]))
    found = smoothed(t, u[None], y[None])
    parameters = np.asarray(found.parameters)[0, 0]
    step = float(found.parameter_covariance[0, 0, 0, 0]) ** 0.5

    def known(resistance):
        relation = aslo.plants.FluxRelation(resistance, L, parameters[1])
        return aslo.smooth(aslo.Lifted(relation, CURRENT, VOLTAGE), t, u, y)

    up, here, down = (known(parameters[0] + k * step) for k in (1, 0, -1))
    slope = np.asarray(up.value - down.value) / (2.0 * step)
    np.testing.assert_allclose(found.value[0], here.value, rtol=0, atol=1e-9 * M)
    expected = here.covariance + step**2 * slope[:, :, None] * slope[:, None, :]
    scale = np.trace(expected, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(found.covariance[0] / scale, expected / scale, atol=1e-3)


def test_a_hole_and_what_is_refused():
    t, u, y, flux = logs([400, 401])
    hole = slice(900, 930)
    u[:, hole] = y[:, hole] = np.nan
    found = smoothed(t, u, y, "coast")
    lost = np.zeros(ROWS, bool)
    lost[hole.start : hole.stop + 1] = True
    np.testing.assert_array_equal(found.coasting, np.broadcast_to(lost, (2, ROWS)))
    each = squares(np.asarray(found.value) - flux, np.asarray(found.covariance))
    assert each[:, lost].mean() < 3.0 and each[:, ~lost].mean() < 2.5
    with pytest.raises(ValueError, match="must have parameters that are constant"):
        aslo.smooth(observer(drift=0.01), t, u[0], y[0], missing="coast")
    # At rest nothing is told.
    still = jnp.zeros((300, 2)) + 1e-9
    assert aslo.smooth(observer(), t[:300], still, still).coasting.all()
