"""Exported C in single precision: how far it is off, and where it keeps its digits."""

import re

import numpy as np
import pytest
from compiled_c import Compiled, error, rows_of
from exported_motor import export_motor, motor_estimate, motor_log

import aslo_jax as aslo


def test_single_precision_is_as_near_as_is_said(tmp_path):
    log = motor_log()
    expected = motor_estimate()
    made = export_motor(dtype="float32")
    code = made.files["motor.c"]
    assert not re.search(r"\bdouble\b|\d\.\d+(e[-+]?\d+)?(?![\d.e]*f)\b", code)
    found = Compiled(made, tmp_path)(rows_of(log.u, log.y))
    angle = (found[:, 0] - expected[:, 0] + np.pi) % (2 * np.pi) - np.pi
    both = (found[:, 2] == 0) & (expected[:, 2] == 0) & (expected[:, 3] == 0)
    assert np.mean(found[:, 2] != expected[:, 2]) < 1e-3
    settled = both & (np.arange(len(both)) > 100)
    assert np.max(np.abs(angle[settled])) < 5e-5  # rad
    assert error(found[settled, 4:6], expected[settled, 4:6]) < 2e-5
    assert np.max(np.abs(found[settled, 6] - expected[settled, 6])) < 0.02  # rad/s


def test_a_slow_filter_keeps_its_digits_in_single_precision(tmp_path):
    """What it loses over an interval is a part in 67,000, of which `1 - decay` would have
    three digits, and the filter an error of 1e-3."""
    rows = np.ones((100_000, 1))
    made = aslo.export_c(
        aslo.LowPass(0.3), interval=5e-5, y=1.0, dtype="float32", prefix="slow"
    )
    found = Compiled(made, tmp_path)(rows)[:, 0]
    exact = -np.expm1(-0.3 * 5e-5 * np.arange(100_000))
    assert np.max(np.abs(found - exact)) < 3e-5


def test_a_loop_in_single_precision_turns_for_ever(tmp_path):
    """After a million radians the angle has the digits that it had at first."""
    t = 1e-3 * np.arange(20_000)
    angle = 1e6 + 300.0 * t
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    loop = aslo.PhaseLockedLoop(60.0, within=True)
    settings = dict(interval=1e-3, u=np.zeros(1), y=0.0, dtype="float32", prefix="pll")
    made = aslo.export_c(loop, **settings)
    found = Compiled(made, tmp_path)(rows_of(np.zeros((20_000, 1)), wrapped))
    off = (found[500:, 0] - wrapped[500:] + np.pi) % (2 * np.pi) - np.pi
    assert np.max(np.abs(off)) < 1e-4
    assert np.max(np.abs(found[500:, 1] - 300.0)) < 0.1


@pytest.mark.slow
def test_ten_thousand_models_in_single_precision(tmp_path):
    """Of parameters, cutoffs and bandwidths: how far single precision is off where both
    are certified."""
    log = motor_log()
    single = Compiled(export_motor(dtype="float32"), tmp_path / "single")
    double = Compiled(export_motor(), tmp_path / "double")
    rows = rows_of(log.u, log.y)[:2000]
    names = [f.name for f in double.exported.parameters]
    start = np.array([float(f.default) for f in double.exported.parameters])
    spread = {name: 0.2 for name in names if "relation" in name or "connect" in name}
    spread |= {"first_filter_rate": 0.8, "second_bandwidth": 0.5}
    rng = np.random.default_rng(0)
    worst, apart = [], []
    for _ in range(10_000):
        values = start.copy()
        for name, share in spread.items():
            values[names.index(name)] *= rng.uniform(1.0 - share, 1.0 + share)
        a, b = single(rows, values), double(rows, values)
        both = (a[:, 2] == 0) & (b[:, 2] == 0) & (np.arange(len(a)) > 100)
        apart.append(np.mean(a[:, 2] != b[:, 2]))
        magnet = start[names.index("first_relation_magnet_flux")]
        off = np.abs(a - b)[both][:, 4:6] / magnet
        worst.append(np.max(off, initial=0.0))
    assert np.median(worst) > 1e-8  # there were certified rows
    assert np.max(worst) < 5e-6  # of the magnet's flux; measured 1.7e-6
    assert max(apart) < 1e-3
