"""Instants of logs that are rounded, of a coarse clock, or in another unit, named so."""

import numpy as np
import pytest
from motor_logs import MOTORS, estimated, in_alpha_beta, noisy, run

from aslo_jax.diagnosis import of_stamps
from aslo_jax.logs import Log, LogError

SERVO = next(motor for motor in MOTORS if motor.name == "servo")
ROWS = np.arange(4001)


def kinds(t, longest=5e-3):
    return [warning.kind for warning in of_stamps(t, longest).warnings]


@pytest.mark.parametrize("interval", [1e-4, 2.5e-4, 1.0 / 3000.0, 5e-5, 1.0 / 8192.0])
def test_right_instants_pass_in_silence(interval):
    jitter = 0.05 * interval * np.random.default_rng(1).uniform(size=ROWS.size)
    for t in (interval * ROWS, 100.0 + interval * ROWS, interval * ROWS + jitter):
        assert kinds(t) == []
        assert kinds(np.round(t, 9)) == []
    assert kinds((interval * ROWS).astype(np.float32).astype(float)[:300]) == []


def test_missing_rows_of_an_even_log_are_not_rounded():
    kept = np.random.default_rng(1).random(ROWS.size) > 0.02
    assert kinds(2e-4 * ROWS[kept]) == []


def test_steps_of_about_an_interval_are_coarse_instants_and_not_missing_rows(tmp_path):
    """A clock that ticks a little faster than rows come skips a tick now and then."""
    t = (2.5e-4 * ROWS + 4000.0).astype(np.float32).astype(float)
    assert kinds(t) == ["coarse_time"]
    assert kinds(np.round(1.02e-3 * ROWS, 3)) == ["coarse_time"]
    kept = np.random.default_rng(2).random(ROWS.size) > 0.003
    assert kinds(np.round(1e-3 * ROWS[kept], 3)) == []
    log = in_alpha_beta(noisy(run(SERVO, "rich"), SERVO, 1, 0.003))
    single = (2.5 * log["t"] + 4000.0).astype(np.float32).astype(float)
    found, _ = estimated(tmp_path, SERVO, log | {"t": single})
    assert "missing_rows" not in [warning["kind"] for warning in found["warnings"]]


def test_rows_that_coast_for_a_cause_that_is_named_are_not_named_again(tmp_path):
    log = in_alpha_beta(noisy(run(SERVO, "rich"), SERVO, 1, 0.003))
    for factor in (1e3, 1e9):
        found, _ = estimated(tmp_path, SERVO, log | {"t": factor * log["t"]})
        assert [warning["kind"] for warning in found["warnings"]] == ["time_unit"]


def test_rounded_instants_are_named():
    t = np.round(2.5e-4 * ROWS + 1e-6, 4)
    (warning,) = of_stamps(t, 5e-3).warnings
    assert warning.kind == "coarse_time"
    assert "rounded to 0.0001 s, 40 % of the mean interval" in warning.message
    assert "every 0.00025 s" in warning.message


def test_a_clock_in_single_precision_is_named():
    t = (900.0 + 2e-4 * ROWS).astype(np.float32).astype(float)
    (warning,) = of_stamps(t, 5e-3).warnings
    assert warning.kind == "coarse_time"
    assert "of a clock in single precision" in warning.message


@pytest.mark.parametrize(("name", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_other_units_are_named(name, factor):
    (warning,) = of_stamps(factor * 1e-4 * ROWS, 5e-3).warnings
    assert warning.kind == "time_unit"
    assert f"`t` may be in {name}" in warning.message


def refusal(t):
    zeros = np.zeros((t.size, 2))
    with pytest.raises(LogError) as raised:
        Log.from_columns(
            {"t": t, "u_alpha": zeros[:, 0], "u_beta": zeros[:, 0]}
            | {"i_alpha": zeros[:, 0], "i_beta": zeros[:, 0]}
        )
    return str(raised.value)


def test_ties_say_why():
    said = refusal(np.round(2.5e-4 * ROWS, 3))
    assert "of 4000 intervals: its instants are rounded to 0.001 s" in said
    assert "0.00025 s times the number of the row" in said
    single = (9000.0 + 2e-4 * ROWS).astype(np.float32).astype(float)
    assert "are of a clock in single precision" in refusal(single)
    twice = 1e-4 * ROWS
    twice[7] = twice[6]
    assert "sort the log and drop repeated rows" in refusal(twice)


def test_the_command_names_the_unit_of_time_alone(tmp_path, capsys):
    log = noisy(run(SERVO, "rich"), SERVO, 3, 0.005)
    columns = in_alpha_beta(log)
    summary, _ = estimated(tmp_path, SERVO, columns | {"t": 1e3 * log["t"]}, "-q")
    kinds = [warning["kind"] for warning in summary["warnings"]]
    assert kinds[0] == "time_unit" and set(kinds[1:]) <= {"mostly_coasting"}
    summary, _ = estimated(
        tmp_path, SERVO, columns | {"t": 1e3 * log["t"]}, "--column", "t=t*1e-3", "-q"
    )
    assert summary["warnings"] == []
