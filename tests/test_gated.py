"""Outliers are left out, and true jumps are followed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM

import aslo_jax as aslo

MOTOR = PrescribedPMSM(resistance=0.9, inductance=3e-3, magnet_flux=0.05, pole_pairs=4)
DT, ROWS = 1e-3, 700
T = np.arange(ROWS) * DT


def motor_log(noise=0.01):
    row = lambda t: (MOTOR.mean_voltage(t, t + DT), MOTOR.current(t), MOTOR.flux(t))
    u, y, flux = map(np.asarray, jax.vmap(row)(jnp.asarray(T)))
    return u, y + noise * np.random.default_rng(2).normal(size=y.shape), flux


def observer():
    return aslo.AlgebraicObserver(
        MOTOR.relation(), aslo.LowPass(25.0), guard=aslo.Guard(1e-3)
    )


def worst(found, flux, first=300):
    return np.linalg.norm(found.value - flux, axis=1)[first:].max() / MOTOR.magnet_flux


@pytest.mark.parametrize("engine", ["scan", "fused"])
def test_spikes_are_left_out_and_flagged(engine):
    u, y, flux = motor_log()
    spoilt = y.copy()
    rows = [310, 400, 401, 560]
    spoilt[rows, [0, 1, 0, 1]] += 50.0
    raw = aslo.replay(observer(), T, u, spoilt, engine=engine)
    gated = aslo.replay(aslo.Gated(observer()), T, u, spoilt, engine=engine)
    clean = aslo.replay(observer(), T, u, y, engine=engine)
    assert worst(raw, flux) > 1.0
    assert worst(gated, flux) < worst(clean, flux) + 5e-3
    assert np.flatnonzero(gated.coasting[50:] & ~clean.coasting[50:]).tolist() == [
        k - 50 for k in rows
    ]


def test_a_gate_is_like_samples_that_are_missing():
    u, y, _ = motor_log()
    spoilt, lost = y.copy(), y.copy()
    spoilt[400] += 50.0
    lost[400] = np.nan
    gated = aslo.replay(aslo.Gated(observer()), T, u, spoilt)
    missing = aslo.replay(observer(), T, u, lost, missing="coast")
    np.testing.assert_allclose(gated.value[50:], missing.value[50:], rtol=1e-9)


def test_a_true_jump_is_accepted_after_so_many_samples():
    y = 0.01 * np.random.default_rng(0).normal(size=(400, 1)) + 2.0 * (T[:400, None] > 0.2)
    made = aslo.Gated(aslo.HighGain(100.0), patience=4)
    rejected = aslo.replay(made, T[:400], 0 * y, y).coasting
    assert np.flatnonzero(rejected).tolist() == [201, 202, 203, 204]


def test_noise_that_grows_is_let_in():
    rng = np.random.default_rng(0)
    y = np.where(T[:, None] > 0.3, 1.0, 0.01) * rng.normal(size=(ROWS, 1))
    rejected = aslo.replay(aslo.Gated(aslo.HighGain(100.0)), T, 0 * y, y).coasting
    assert rejected[301:400].any() and not rejected[:300].any()
    assert not rejected[-200:].any()


def test_the_steps_of_an_encoder_at_rest_are_no_outliers():
    step = 1e-3
    y = step * np.floor(np.maximum(T - 0.4, 0.0) * 30.0)[:, None]
    run = lambda made: aslo.replay(made, T, 0 * y, y).coasting
    assert run(aslo.Gated(aslo.HighGain(100.0))).any()
    assert not run(aslo.Gated(aslo.HighGain(100.0), least=step)).any()


def test_refusals():
    with pytest.raises(ValueError, match="Argument `patience` must be a whole number"):
        aslo.Gated(observer(), patience=0)
    with pytest.raises(ValueError, match="Argument `threshold`"):
        aslo.Gated(observer(), threshold=0.0)
