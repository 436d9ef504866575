"""Errors of a record: named where they are not asked for, found where they are; and
intervals where a parameter enters nonlinearly."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from machine_records import motor_log

import aslo_jax as aslo
from aslo_jax.tune import calibrate
from aslo_jax.tune._calibration.imperfections import STAR, perfect
from aslo_jax.tune._calibration.profile import profile
from aslo_jax.tune._calibration.whiten import Signals

MOTOR = aslo.plants.PMSM(0.62, 2.1e-3, 0.036, 4, 90e-6)
TRUTH = {"resistance": 0.62, "inductance": 2.1e-3, "magnet_flux": 0.036}
SIZE = {"offset": 0.35, "dead_time": 0.4, "delay": 1.0}
FIELD = {"offset": "output_offset[0]", "dead_time": "dead_time", "delay": "delay"}


def where(p):
    return p.resistance, p.inductance, p.magnet_flux


def clean(varied=True, seed=0, noise=2e-3):
    return motor_log(
        MOTOR, 260.0,
        lambda t: (3.0 if varied else 0.0) * jnp.sin(47 * t),
        lambda t: 5.0 * (1 + 0.4 * jnp.sin(29 * t)), 1e-4, 1500, noise, seed,
    )  # fmt: skip


def spoilt(error):
    """A log with one error, made without the code that is tested."""
    t, u, y = clean()
    if error == "offset":
        y = y + np.array([SIZE[error], 0.0])
    if error == "dead_time":
        i = clean(noise=0.0)[2] @ np.array([[1, -0.5, -0.5], [0, 0.75**0.5, -(0.75**0.5)]])
        a, b, c = (SIZE[error] * np.tanh(i / 0.1)).T
        u = u + np.stack([(2 * a - b - c) / 3, (b - c) / 3**0.5], axis=1)
    if error == "delay":
        u = np.concatenate([u[:1], u[:-1]])
    return t, u, y


def off(factors):
    values = [v * f for v, f in zip(TRUTH.values(), factors, strict=True)]
    return eqx.tree_at(where, MOTOR, values)


@pytest.mark.parametrize(
    "error", [pytest.param(e, marks=[pytest.mark.slow] * (e != "delay")) for e in SIZE]
)
def test_an_error_is_named_and_the_intervals_are_withdrawn(error):
    found = calibrate(off((1.1, 0.9, 1.05)), *spoilt(error), where)
    field = FIELD[error].partition("[")[0]
    assert found.findings[0].field == field
    assert found.findings[0].size.ravel()[0] == pytest.approx(SIZE[error], rel=0.2)
    assert found.withdrawn
    assert all(np.isnan(x) for x in found.after.values())
    assert all(np.isnan(x).all() for x in found.interval.values())
    assert all(
        float(a) == float(b)
        for a, b in zip(where(found.model), where(off((1.1, 0.9, 1.05))), strict=True)
    )


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "error",
    [pytest.param(e, marks=SLOW) if e != "dead_time" else e for e in SIZE],
)
def test_an_error_is_found_where_it_is_asked_for(error):
    """All three are asked for: two of them are found to be nothing."""
    found = calibrate(off((1.1, 0.9, 1.05)), *spoilt(error), where, fit=tuple(SIZE))
    assert not found.withdrawn and not found.findings
    for name, true in TRUTH.items():
        assert found.after[name] == pytest.approx(true, rel=3e-3), name
    for name, field in FIELD.items():
        true = SIZE[name] if name == error else 0.0
        assert found.estimate[field] == pytest.approx(true, abs=0.05 * SIZE[name]), name


@pytest.mark.parametrize(
    "factors",
    [
        (2.0, 0.5, 1.3),
        pytest.param((0.5, 2.0, 0.7), marks=SLOW),
        pytest.param((1.0, 1.0, 1.0), marks=SLOW),
    ],
)
def test_a_right_log_shows_no_error_and_may_start_a_factor_of_two_off(factors):
    found = calibrate(off(factors), *clean(), where)
    assert found.findings == () and not found.withdrawn
    for name, true in TRUTH.items():
        low, high = found.interval[name]
        assert abs(found.after[name] - true) < 0.75 * (high - low)
        assert high - low < 0.02 * true


def test_currents_of_the_wrong_sign_are_refused():
    t, u, y = clean()
    with pytest.raises(ValueError, match="sign of all outputs turned the log fits"):
        calibrate(off((1.1, 0.9, 1.05)), t, u, -y, where)


@pytest.mark.slow
def test_without_direct_current_the_interval_of_the_inductance_is_wide_and_holds():
    """The relation depends on it in second order: there is no interval, or it holds; of 12,
    at most two do not."""
    missed = 0
    for seed in range(12):
        found = calibrate(off((1.1, 0.9, 1.05)), *clean(False, seed, 1e-2), where)
        low, high = found.interval["inductance"]
        missed += low > TRUTH["inductance"] or TRUTH["inductance"] > high
        assert np.isnan(found.after["inductance"])
        assert "not determined" in str(found)
    assert missed <= 2


def test_an_error_of_another_name_is_refused():
    with pytest.raises(ValueError, match=r"must be of offset, output_offset, .* `ofset`"):
        calibrate(MOTOR, *clean(), where, fit=("ofset",))


def test_what_imperfections_do_to_signals():
    """In closed form, one by one."""
    rng = np.random.default_rng(4)
    u, y = rng.standard_normal((2, 40, 2))
    log = Signals(jnp.ones(39), jnp.asarray(u), jnp.asarray(y))
    none = perfect(MOTOR, log)
    assert all(np.array_equal(a, b) for a, b in zip(none(log), log, strict=True))
    late = lambda delay, log: eqx.tree_at(lambda i: i.delay, none, jnp.asarray(delay))(log)
    np.testing.assert_allclose(late(1.0, log).u[:-1], u[1:], rtol=1e-13)
    np.testing.assert_allclose(late(-2.0, log).u[2:], u[:-2], rtol=1e-13)
    # A fraction lies on a curve through the samples that has parabolas right, and no kink
    # at whole samples, where a search would stay.
    k = np.arange(40.0)[:, None] * np.ones(2)
    for delay in (1.25, -0.5):
        found = late(delay, log._replace(u=jnp.asarray(k**2))).u
        np.testing.assert_allclose(found[3:-4], (k[3:-4] + delay) ** 2, rtol=1e-13)
    slopes = [jax.jacfwd(lambda d: late(d, log).u[20])(x) for x in (1 - 1e-9, 1 + 1e-9)]
    np.testing.assert_allclose(slopes[0], slopes[1], atol=1e-6)
    both = eqx.tree_at(
        lambda i: (i.gain, i.input_offset, i.output_offset),
        none,
        (jnp.asarray(1.1), jnp.array([0.3, -0.2]), jnp.array([0.05, 0.07])),
    )(log)
    np.testing.assert_allclose(both.u, 1.1 * u + [0.3, -0.2], rtol=1e-13)
    np.testing.assert_allclose(both.y, y - [0.05, 0.07], rtol=1e-13)
    # Far above the threshold a dead time is a six-step of 4/3 of it, along the currents.
    dead = eqx.tree_at(
        lambda i: (i.dead_time, i.threshold), none, (jnp.asarray(0.6), jnp.asarray(1e-9))
    )(log)
    lost = np.asarray(u - dead.u)
    np.testing.assert_allclose(lost, 2 / 3 * 0.6 * np.sign(y @ STAR.T) @ STAR, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(lost, axis=1), 4 / 3 * 0.6, rtol=1e-12)
    stepper = perfect(aslo.plants.Stepper(0.55, 1.5e-3, 0.19, 50, 4.5e-5), log)
    dead = eqx.tree_at(
        lambda i: (i.dead_time, i.threshold), stepper, (jnp.asarray(0.6), jnp.asarray(1e-9))
    )(log)
    np.testing.assert_allclose(u - dead.u, 0.6 * np.sign(y), atol=1e-12)


def test_the_profile_of_a_linear_problem_is_that_of_its_covariance():
    rng = np.random.default_rng(2)
    A, b = rng.standard_normal((60, 3)), rng.standard_normal(60)
    best = np.linalg.lstsq(A, b, rcond=None)[0]
    evaluate = lambda v: (A @ v - b, A)
    deviation = np.sqrt(np.linalg.inv(A.T @ A)[1, 1])
    for inflation in (1.0, 2.5):
        found = profile(
            evaluate, best, 1, 1.0, deviation, 0.95, lambda v, x=inflation: x, 9.0, 1
        )
        half = 1.959964 * deviation * np.sqrt(inflation)
        assert found.parabolic
        assert found.high == pytest.approx(best[1] + half, rel=1e-5)
        assert found.low == pytest.approx(best[1] - half, rel=1e-5)


def test_the_profile_sees_a_second_valley():
    """`(x^2 - 1)^2` has two; a hill between them that is below the limit hides none."""
    size = 1.5

    def evaluate(v):
        return size * (v**2 - 1.0), size * np.diag(2.0 * v)

    found = profile(
        evaluate, np.ones(1), 0, 1.0, 1 / (2 * size), 0.95, lambda v: 1.0, 9.0, 1
    )
    end = np.sqrt(1.0 + np.sqrt(5.991465) / size)
    assert not found.parabolic
    assert found.high == pytest.approx(end, rel=0.02)
    assert found.low == pytest.approx(-end, rel=0.02)


def test_an_angle_ahead_of_the_magnet_is_found():
    """In closed form: the angle of the record's motor, and 0.13 rad more."""
    t, u, y = clean()
    angle = 4 * 0.3 + 260.0 * t + 0.25 * 260.0 / 9 * (1 - np.cos(9 * t))
    found = calibrate(
        off((1.1, 0.9, 1.05)), t, u, y, where, fit=("encoder_offset",), angle=angle + 0.13
    )
    assert abs(found.estimate["encoder_offset"] - 0.13) < 2e-3
    assert np.isnan(found.interval["encoder_offset"]).all()
    assert "about 0.13, without an interval" in str(found)
    assert found.before["encoder_offset"] == 0.0
    fit = {"where": where, "fit": ("encoder_offset",)}
    with pytest.raises(ValueError, match="for a log without an angle"):
        calibrate(MOTOR, t, u, y, **fit)
    with pytest.raises(ValueError, match=r"`angle` must be finite and of shape \(1500,\)"):
        calibrate(MOTOR, t, u, y, **fit, angle=angle[1:])
