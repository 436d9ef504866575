"""Truth in another unit, or of other pole pairs, is named."""

import numpy as np
import pytest
from motor_logs import MOTORS, estimated, in_alpha_beta, noisy, run

from aslo_jax.diagnosis import Truth

SERVO = next(motor for motor in MOTORS if motor.name == "servo")
T = np.linspace(0.0, 2.0, 4001)
ANGLE, SPEED = 60.0 * T + 3.0 * np.sin(4.0 * T), 60.0 + 12.0 * np.cos(4.0 * T)
WRAPPED = (ANGLE + np.pi) % (2.0 * np.pi) - np.pi


def said(estimate, truth, angle=True, mechanical=False):
    found = Truth("theta", angle, 4, mechanical)
    noise = np.random.default_rng(3).normal(size=(2, T.size))
    found.add(estimate + 1e-3 * noise[0], truth + 5e-3 * noise[1])
    return [(w.kind, w.message) for w in found.diagnosis().warnings]


@pytest.mark.parametrize("scale", [1.0, 0.95, 1.05])
def test_right_truth_passes_in_silence(scale):
    assert said(ANGLE, scale * ANGLE) == said(ANGLE, WRAPPED) == []
    assert said(SPEED, scale * SPEED, angle=False) == []
    assert said(0.0 * T, np.random.default_rng(1).normal(size=T.size)) == []


CASES = {
    "degrees": (ANGLE, np.degrees(WRAPPED), True, False, "truth_unit"),
    "degrees from 0": (ANGLE, np.degrees(ANGLE) % 360, True, False, "truth_unit"),
    "rpm": (SPEED, SPEED * 30 / np.pi, False, False, "truth_unit"),
    "backwards": (ANGLE, -ANGLE, True, False, "truth_sign"),
    "mechanical": (ANGLE, ANGLE / 4, True, False, "truth_mechanical"),
    "pole pairs": (SPEED, SPEED * 4 / 7, False, True, "pole_pairs"),
    "unknown": (SPEED, 3.3 * SPEED, False, False, "truth_scale"),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_truth_is_named(case):
    *arguments, kind = CASES[case]
    ((found, message),) = said(*arguments)
    assert found == kind
    if case == "pole pairs":
        assert "seems to have 7 pole pairs rather than 4" in message


def test_the_command_tells_wrong_pole_pairs(tmp_path, capsys):
    log = noisy(run(SERVO, "rich"), SERVO, 3, 0.005)
    speed = np.gradient(log["angle"], SERVO.dt)
    columns = in_alpha_beta(log)
    named = lambda more: [
        warning["kind"]
        for warning in estimated(tmp_path, SERVO, columns | more, "-q")[0]["warnings"]
    ]
    assert named({"omega_mechanical": speed / SERVO.pole_pairs}) == []
    assert named({"omega_mechanical": speed / 3}) == ["pole_pairs"]
    assert named({"theta_electrical": np.degrees(log["angle"])}) == ["truth_unit"]
