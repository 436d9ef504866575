"""`Lifted` over samples that are missing: it knows how little it knows."""

import equinox as eqx
import jax
import numpy as np
import pytest

import aslo_jax as aslo

R, L, M = 0.41, 1.3e-3, 0.024
H, ROWS, FIRST = 1e-4, 4000, 1500
U_NOISE, Y_NOISE = 0.08, 8e-3
OBSERVER = aslo.Lifted(
    aslo.plants.FluxRelation(R, L, M),
    output_deviation=Y_NOISE,
    input_deviation=U_NOISE,
)


def turning(a):
    return np.stack([np.cos(a), np.sin(a)], axis=-1)


def log(speed, seed):
    """A motor at constant speed (rad/s) with 5 A, 0.4 rad ahead of the q axis, and noise;
    its voltages are the exact means over the intervals."""
    t = H * np.arange(ROWS)
    current = lambda t: 5.0 * turning(speed * t + 0.5 * np.pi + 0.4)
    flux = lambda t: M * turning(speed * t) + L * current(t)
    # The mean of a current that turns is that of the middle times sin(x) / x.
    mean = current(t + 0.5 * H) * np.sinc(speed * H / 2.0 / np.pi)
    u = R * mean + (flux(t + H) - flux(t)) / H
    rng = np.random.default_rng(seed)
    noise = lambda size: size * rng.standard_normal((ROWS, 2))
    return t, u + noise(U_NOISE), current(t) + noise(Y_NOISE), flux(t)


@eqx.filter_jit
def many(t, u, y):
    one = lambda u, y: aslo.replay(OBSERVER, t, u, y, missing="coast")
    return jax.vmap(one)(u, y)


@pytest.mark.parametrize(("speed", "angle"), [(40.0, 0.5), (250.0, 0.4), (250.0, 2.5)])
@pytest.mark.parametrize("lost", ["both", "u", "y"])
def test_its_deviations_hold_after_a_hole(speed, angle, lost):
    """Of eight logs, in the rows that are not flagged, and these come back."""
    logs = [log(speed, seed) for seed in range(8)]
    t = logs[0][0]
    u, y, flux = (np.stack([x[k] for x in logs]) for k in (1, 2, 3))
    last = FIRST + int(angle / (speed * H))
    for name, signal in (("u", u), ("y", y)):
        if lost in (name, "both"):
            signal[:, FIRST:last] = np.nan
    found = many(t, u, y)
    assert np.isfinite(found.value).all()
    assert np.asarray(found.coasting)[:, FIRST + 1 : last].all()
    after = slice(last, None)
    trusted = ~np.asarray(found.coasting)[:, after]
    assert trusted[:, -200:].all()
    error = (np.asarray(found.value) - flux)[:, after]
    inverse = np.linalg.inv(np.asarray(found.covariance)[:, after])
    squares = np.einsum("bti,btij,btj->bt", error, inverse, error) / 2.0
    assert squares[trusted].mean() < 2.0
    # Three deviations of either entry: the worst of some thousand rows.
    assert squares[trusted].max() < 12.0
    size = np.linalg.norm(flux, axis=2)[:, after]
    assert (np.linalg.norm(error, axis=2) / size)[trusted].max() < 0.35


def test_a_step_that_misses_nothing_is_that_of_a_log_without_holes():
    t, u, y, _ = log(120.0, 3)
    whole = aslo.replay(OBSERVER, t[:300], u[:300], y[:300])
    coasting = aslo.replay(OBSERVER, t[:300], u[:300], y[:300], missing="coast")
    np.testing.assert_allclose(coasting.value, whole.value, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(coasting.covariance, whole.covariance, rtol=1e-9, atol=1e-18)
