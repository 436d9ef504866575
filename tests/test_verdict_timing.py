"""The verdict on the timing of voltages where speed or current are constant, and on rows
that are lost by ones and twos."""

import numpy as np
import pytest
from motor_logs import PROFILES, Motor, as_log, late, noisy, run, without

from aslo_jax.diagnosis import diagnose

LIFT = Motor("lift", "pmsm", 0.06, 0.45e-3, 0.45e-3, 0.09, 4, 820.0, 150.0, 1e-4)
KITE = Motor("kite", "pmsm", 0.07, 40e-6, 40e-6, 3.1e-3, 7, 1900.0, 11.0, 5e-5)
LATHE = Motor("lathe", "pmsm", 1.7, 4.1e-3, 4.1e-3, 0.11, 3, 420.0, 5.0, 1.5e-4)
SWIVEL = Motor("swivel", "pmsm", 2.1, 6e-3, 6e-3, 0.14, 4, 260.0, 3.0, 1e-4)

# At constant speed the current steps, in one row, or goes to another value as a lag does.
STEPS = (
    lambda s: 0.9 + 0.0 * s,
    lambda s: 0.0 * s,
    lambda s: 0.3 + 0.5 * (s > 0.37) - 0.6 * (s > 0.81),
)
LAGS = (
    lambda s: 0.9 + 0.0 * s,
    lambda s: 0.0 * s,
    lambda s: 0.3 - 0.5 * np.expm1(-700.0 * np.maximum(s - 0.4, 0.0)),
)


@pytest.fixture
def recorded(monkeypatch):
    """A log of a motor and a profile, with noise of the current and a quarter of it of the
    voltage."""

    def of(motor, profile, noise=0.003, seed=6):
        if not isinstance(profile, str):
            monkeypatch.setitem(PROFILES, "own", profile)
            profile = "own"
        return noisy(run(motor, profile), motor, seed, noise, noise / 4)

    return of


def warnings(log, motor, **changed):
    return diagnose(as_log(log), [motor.circle(**changed)]).warnings


@pytest.mark.parametrize("rows", [-2, -1, 1, 2])
@pytest.mark.parametrize("motor", [LIFT, KITE], ids=lambda m: m.name)
def test_steps_of_the_load_tell_the_timing_and_no_outliers(recorded, motor, rows):
    log = recorded(motor, STEPS)
    assert warnings(log, motor) == ()
    (warning,) = warnings(log | {"u": late(log["u"], rows)}, motor)
    assert warning.kind == "voltage_timing"
    assert f"delayed={rows}" in warning.message


@pytest.mark.parametrize("rows", [-2, -1, 1, 2])
@pytest.mark.parametrize("motor", [LIFT, KITE, LATHE], ids=lambda m: m.name)
def test_a_late_voltage_makes_no_rows_suspect(recorded, motor, rows):
    """Neither where the current steps, nor where the record ends with that."""
    ends = (*STEPS[:2], lambda s: STEPS[2](s) - 0.4 * (s > 0.9997))
    for profile in (STEPS, LAGS, ends):
        log = recorded(motor, profile)
        found = warnings(log | {"u": late(log["u"], rows)}, motor)
        assert not {w.kind for w in found} & {"outliers", "input_outliers", "lost_rows"}


def test_at_constant_speed_and_current_both_causes_are_named(recorded):
    """A magnet flux that is exactly as far off as late voltages make it look."""
    log = recorded(LIFT, "constant")
    assert warnings(log, LIFT) == ()
    (warning,) = warnings(log | {"u": late(log["u"], 1)}, LIFT)
    assert warning.kind == "voltage_timing"
    timing, resistance, magnet = warning.message.split(", or ")[:3]
    assert "1 row late" in timing
    assert "resistance" in resistance
    told = float(magnet.split(" is ")[1].split(" times")[0])
    # The voltage over j omega, turned back by omega h, along the magnet.
    turn = LIFT.speed * LIFT.dt
    flux = LIFT.psi + 0.6j * LIFT.current * (LIFT.Lq - 1j * LIFT.R / LIFT.speed)
    off = abs(LIFT.psi + flux * (np.exp(-1j * turn) - 1.0)) / LIFT.psi
    assert told == pytest.approx(off, abs=3e-3)
    error = float(warning.message.split("off by about ")[1].split(" %")[0])
    assert error == pytest.approx(100.0 * turn, rel=0.2)


@pytest.mark.parametrize("factor", [0.93, 0.97, 0.99, 1.03, 1.07])
def test_a_magnet_that_is_off_by_another_amount_is_none_of_the_timing(recorded, factor):
    log = recorded(LIFT, "constant")
    assert warnings(log, LIFT, psi=factor * LIFT.psi) == ()


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("motor", [LIFT, KITE, LATHE, SWIVEL], ids=lambda m: m.name)
def test_few_rows_that_are_lost_are_seen(recorded, motor, count):
    """Where they turn the flux by 4 % or more."""
    if motor.speed * motor.dt * count < 0.05:
        count += 1
    for profile in ("rich", "load", "constant"):
        log = recorded(motor, profile, 0.002)
        cut = without(log, slice(1702, 1702 + count))
        (warning,) = warnings(cut, motor)
        assert warning.kind == "lost_rows"
        assert set(warning.rows) <= {1700, 1701, 1702}


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.02])
@pytest.mark.parametrize("profile", ["rich", "reversal", "start", "steps"])
def test_of_a_whole_log_no_row_seems_lost(recorded, profile, noise):
    for motor in (KITE, SWIVEL):
        assert warnings(recorded(motor, profile, noise), motor) == ()


@pytest.mark.parametrize("rows", [-1, 1])
@pytest.mark.parametrize(
    "motor",
    [
        Motor("blade", "pmsm", 0.085, 28e-6, 28e-6, 1.7e-3, 7, 2100.0, 14.0, 4e-5),
        Motor("rotor", "pmsm", 0.11, 36e-6, 36e-6, 1.9e-3, 7, 1950.0, 14.0, 4e-5),
    ],
    ids=lambda m: m.name,
)
def test_a_load_that_varies_tells_the_timing_beside_a_resistance(motor, rows):
    """Without leaps of the current another resistance mends all but the level."""
    log = noisy(run(motor, "load", 2501), motor, 6, 0.005)
    assert warnings(log, motor) == ()
    assert warnings(log, motor, R=1.03 * motor.R) == ()
    (warning,) = warnings(log | {"u": late(log["u"], rows)}, motor)
    assert warning.kind == "voltage_timing"
    assert f"delayed={rows}" in warning.message
    assert "or the resistance is" in warning.message
    assert "constant" not in warning.message
    error = float(warning.message.split("off by about ")[1].split(" %")[0])
    assert error == pytest.approx(100.0 * motor.speed * motor.dt, rel=0.3)
