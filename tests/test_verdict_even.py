"""The verdict on motors of constant speed and current, whose logs tell little, and on the
rows of logs that are wrong as a whole."""

import numpy as np
import pytest
from motor_logs import PROFILES, Motor, as_log, late, noisy, run, without

from aslo_jax.diagnosis import diagnose

WINCH = Motor("winch", "pmsm", 14.5, 31e-3, 31e-3, 0.31, 6, 26.0, 1.1, 5e-4)
TRAIN = Motor("train", "pmsm", 0.042, 0.38e-3, 0.38e-3, 0.083, 4, 880.0, 180.0, 1e-4)
AXIS = Motor("axis", "pmsm", 2.3, 5.2e-3, 5.2e-3, 0.118, 2, 294.0, 3.3, 2.5e-4)
QUAD = Motor("quad", "pmsm", 0.055, 85e-6, 85e-6, 7.1e-3, 7, 1330.0, 7.0, 1e-4)
ROLL = Motor("roll", "pmsm", 0.9, 2.1e-3, 2.1e-3, 0.052, 3, 310.0, 6.0, 2e-4)


def recorded(motor, profile="constant", noise=0.004, seed=3):
    return noisy(run(motor, profile), motor, seed, noise, noise / 4)


def of_profile(motor, profile, noise=0.004, seed=3):
    """A log of speed, d and q current (relative) of time over its length."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PROFILES, "own", profile)
        return recorded(motor, "own", noise, seed)


def kinds(log, motor, **changed):
    return [w.kind for w in diagnose(as_log(log), [motor.circle(**changed)]).warnings]


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_resistance_that_spoils_the_flux_is_told_at_constant_speed(factor):
    """An inductance that would have to be sixteen times as large is no excuse."""
    log = as_log(recorded(WINCH))
    (warning,) = diagnose(log, [WINCH.circle(R=factor * WINCH.R)]).warnings
    assert warning.kind == "undecided"
    assert {"resistance", "radius"} <= set(warning.candidates)
    assert "inductance" not in warning.candidates
    told = float(warning.message.split("resistance is ")[1].split(" ohm")[0])
    np.testing.assert_allclose(told, WINCH.R, rtol=0.01)


def test_delta_parameters_do_not_pass_in_silence_at_constant_speed():
    three = {name: 3.0 * getattr(AXIS, name) for name in ("R", "Ld", "Lq")}
    (warning,) = diagnose(as_log(recorded(AXIS)), [AXIS.circle(**three)]).warnings
    assert {"line_to_line", "resistance"} & {warning.kind, *warning.candidates}


@pytest.mark.parametrize("factor", [0.98, 1.0, 1.02])
@pytest.mark.parametrize("seed", [1, 4, 5])
def test_noise_is_not_taken_for_a_negative_scale(factor, seed):
    weakened = (lambda s: 1.0 + 0 * s, lambda s: -0.4 + 0 * s, lambda s: 0.6 + 0 * s)
    log = of_profile(TRAIN, weakened, 0.01, seed)
    assert kinds(log, TRAIN, R=factor * TRAIN.R) == []


def test_scale_of_voltages_is_positive_where_either_sign_fits():
    log = recorded(ROLL)
    found = diagnose(as_log(log | {"u": log["u"] / 73}), [ROLL.circle()])
    (warning,) = found.warnings
    assert set(warning.candidates) == {"current_scale", "voltage_scale", "radius"}
    assert "wrong sign" not in warning.message
    assert "the voltages are 73" in warning.message


def test_level_of_the_magnet_and_timing_are_noted_where_nothing_else_can_be_told():
    log = recorded(QUAD)
    right = diagnose(as_log(log), [QUAD.circle()])
    assert right.warnings == ()
    (note,) = right.notes
    assert "timing" in note
    assert "A step of the load or of the speed in the same log tells it" in note
    turn = float(note.split(" degrees")[0].split()[-1])
    assert turn == pytest.approx(np.degrees(QUAD.speed * QUAD.dt), rel=0.3)
    sign = diagnose(as_log(log | {"i": -log["i"]}), [QUAD.circle()])
    assert any("magnet flux that fits the log is 1." in note for note in sign.notes)
    rich = diagnose(as_log(recorded(QUAD, "rich")), [QUAD.circle()])
    assert rich.notes == ()


@pytest.mark.parametrize("profile", ["rich", "constant", "load", "start"])
@pytest.mark.parametrize("motor", [QUAD, TRAIN], ids=lambda m: m.name)
def test_loss_is_seen_where_the_flux_jumps_as_far_as_the_current(motor, profile):
    log = without(recorded(motor, profile), slice(1500, 1537))
    (warning,) = diagnose(as_log(log), [motor.circle()]).warnings
    assert warning.kind == "lost_rows"
    assert set(warning.rows) <= {1499, 1500}


def stepping(motor):
    """A log in which the current falls within some rows, at once at first."""
    speed, d, _ = PROFILES["rich"]
    fall = lambda s: 0.8 - 0.5 * (1.0 - np.exp(-500.0 * np.maximum(s - 0.6, 0.0)))
    return of_profile(motor, (speed, d, fall))


@pytest.mark.parametrize("motor", [WINCH, ROLL, TRAIN], ids=lambda m: m.name)
def test_steps_of_the_current_are_no_losses_where_signs_or_timing_are_wrong(motor):
    log = stepping(motor)
    assert kinds(log, motor) == []
    assert kinds(log | {"i": -log["i"]}, motor) == ["sign"]
    for rows in (1, 2):
        assert "lost_rows" not in kinds(log | {"u": late(log["u"], rows)}, motor)


def test_parameter_far_off_is_not_named_before_the_scale_that_fits_alike():
    log = recorded(WINCH, "rich")
    (warning,) = diagnose(as_log(log | {"i": log["i"] / 6}), [WINCH.circle()]).warnings
    assert warning.kind == "current_scale"
    assert "the currents are 5.99" in warning.message
