"""Offsets of voltages and currents are found, taken away and stated."""

import numpy as np
import pytest
from motor_logs import MOTORS, as_log, estimated, in_alpha_beta, noisy, run, spiked

from aslo_jax.diagnosis import diagnose
from aslo_jax.logs import Log, LogError, offset_of

BY_NAME = {motor.name: motor for motor in MOTORS}
SERVO = BY_NAME["servo"]


def shifted(log, u=0.0, i=0.0):
    return log | {"u": log["u"] + u, "i": log["i"] + i}


def recorded(motor, profile="rich"):
    return noisy(run(motor, profile), motor, 4, 0.005, 0.002)


def with_rest(log, rows=600):
    """The log after a standstill without voltage and current, but for noise."""
    white = np.random.default_rng(8).standard_normal((2, rows)) @ (np.eye(rows) + 0j)
    before = lambda x, noise: np.concatenate([noise, x])
    t = (log["t"][1] - log["t"][0]) * np.arange(rows + log["t"].size)
    return {
        "t": t,
        "u": before(log["u"], 0.0 * white[0]),
        "i": before(log["i"], 0.01 * white[1]),
    }


@pytest.mark.parametrize("profile", ["rich", "start", "load", "constant"])
@pytest.mark.parametrize("name", ["small", "servo", "crane", "interior", "stepper"])
def test_whole_periods_tell_an_offset(name, profile):
    motor = BY_NAME[name]
    log = recorded(motor, profile)
    level = np.sqrt(np.mean(np.abs(log["u"]) ** 2))
    u, i = (0.03 - 0.02j) * level, (0.02 + 0.05j) * motor.current
    off = shifted(log, u, i)
    found = offset_of(off["t"], off["u"], off["i"], "periods")
    assert abs(found.voltage - u) < 2e-3 * level
    assert abs(found.current - i) < 2e-3 * motor.current


def test_a_standstill_tells_an_offset_exactly():
    off = shifted(with_rest(recorded(SERVO, "start")), 0.4 - 0.1j, 0.06j)
    found = offset_of(off["t"], off["u"], off["i"], "standstill")
    np.testing.assert_allclose(found.voltage, 0.4 - 0.1j, atol=1e-9)
    np.testing.assert_allclose(found.current, 0.06j, atol=2e-3)
    assert "standstill from" in found.where


def test_what_does_not_tell_an_offset_is_refused():
    log = recorded(SERVO)
    with pytest.raises(LogError, match="needs 64 rows or more in which"):
        offset_of(log["t"], log["u"], log["i"], "standstill")
    rest = recorded(SERVO, "standstill")
    with pytest.raises(LogError, match="needs 5 turns of the voltage"):
        offset_of(rest["t"], rest["u"], rest["i"], "periods")
    stepping = recorded(BY_NAME["crane"], "steps")
    with pytest.raises(LogError, match=r"differ by .*--remove-offset standstill"):
        offset_of(stepping["t"], stepping["u"], stepping["i"], "periods")
    with pytest.raises(LogError, match="must be standstill or periods, but is 'mean'"):
        offset_of(log["t"], log["u"], log["i"], "mean")


@pytest.mark.parametrize("name", ["servo", "crane"])
@pytest.mark.parametrize("size", [0.05, 0.1, 0.2])
def test_an_offset_as_large_as_what_steps_leave_is_refused(name, size):
    """Steps of the current that keep pace with the turns move all means alike, by 5 % here;
    an offset of that size does not make them surer."""
    motor = BY_NAME[name]
    log = recorded(motor, "steps")
    for direction in (1.0, 1j, -1.0, -1j):
        off = shifted(log, i=size * motor.current * direction)
        with pytest.raises(LogError, match="too much to tell an offset"):
            offset_of(off["t"], off["u"], off["i"], "periods")


def test_outliers_and_missing_samples_count_nothing():
    log = spiked(shifted(recorded(SERVO), i=0.1), 2000, 100 * SERVO.current)
    log["u"][1000:1003] = np.nan
    found = offset_of(log["t"], log["u"], log["i"], "periods")
    np.testing.assert_allclose(found.current, 0.1, atol=0.01 * SERVO.current)


def test_a_log_without_its_offset_is_right():
    log = shifted(recorded(SERVO), i=0.08j * SERVO.current)
    circles = [SERVO.circle()]
    (warning,) = diagnose(as_log(log), circles).warnings
    assert warning.kind == "offset"
    assert "--remove-offset periods" in warning.message
    mended = Log.from_columns(in_alpha_beta(log), remove_offset="periods")
    assert diagnose(mended, circles).warnings == ()


def test_the_command_takes_it_away_and_says_so(tmp_path, capsys):
    log = recorded(SERVO)
    off = in_alpha_beta(shifted(log, i=0.08 * SERVO.current))
    summary, table = estimated(tmp_path, SERVO, off, "--remove-offset", "periods")
    out, err = capsys.readouterr()
    assert (err, summary["warnings"]) == ("", [])
    assert "offset removed: " in out
    assert "A of the currents, from 16 or more periods" in out
    removed = summary["log"]["offset_removed"]["current"]
    np.testing.assert_allclose(removed, [0.08 * SERVO.current, 0.0], atol=5e-3)
    flux = table["flux_alpha"] + 1j * table["flux_beta"]
    trusted = (table["coasting"] == 0) & (table["t"] > 0.02)
    assert np.abs(flux - log["flux"])[trusted].max() < 0.01 * SERVO.psi


def test_machines_without_rotating_signals_have_none():
    from aslo_jax.logs import Signals

    force = Signals(inputs=("u1",), outputs=("q1",), truth=())
    t = np.arange(9.0)
    with pytest.raises(LogError, match="but this machine has q1, u1; remove it"):
        Log.from_columns(dict(t=t, u1=t, q1=t), force, remove_offset="periods")
