"""What is said of rows after which an observer has started again, where rows were lost."""

import itertools

import numpy as np
import pytest
from motor_logs import MOTORS, estimated, in_alpha_beta, noisy, run, without

from aslo_jax.cli._restarts import FORGETS, Restarted, slowest, stretches
from aslo_jax.diagnosis import Rows
from aslo_jax.machines._base import Rate

BY_NAME = {motor.name: motor for motor in MOTORS}
NONE = np.zeros(0, int)


def test_estimates_are_believed_after_twice_the_time_that_they_took():
    """A restart after row 39; certified from row 52 on, 12 rows later: 24 rows of doubt."""
    t, coasting = 0.25 * np.arange(200), np.zeros(200, np.uint8)
    coasting[40:52] = 1
    lost = lambda row: Rows(NONE, NONE, np.array([row]), NONE, NONE)
    parts = stretches(200, lost(39))
    assert parts == [slice(0, 40), slice(40, 200)]
    found = Restarted(0.001).doubting(t, coasting, parts)
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(40, 64))
    # A filter of 2 rad/s has forgotten its start after 1.5 s, 6 rows.
    found = Restarted(FORGETS / 1.5).doubting(t, coasting, parts)
    np.testing.assert_array_equal(np.flatnonzero(found), np.arange(40, 58))
    for edges in ([0, 20, 55, 199], [0, 40, 41, 199], [0, 39, 63, 199]):
        doubt, whole = Restarted(0.001), []
        for first, last in itertools.pairwise(edges):
            rows = slice(first, last + 1)
            here = lost(39 - first) if first <= 39 < last else None
            piece = stretches(last + 1 - first, here)
            whole += doubt.doubting(t[rows], coasting[rows], piece)[bool(first) :].tolist()
        np.testing.assert_array_equal(np.flatnonzero(whole), np.arange(40, 64))


def test_the_slowest_filter_is_no_phase_locked_loop():
    rates = {"cutoff": Rate(30.0), "gain": Rate(80.0), "pll_bandwidth": Rate(5.0)}
    assert slowest(rates) == 30.0
    assert slowest({"pll_bandwidth": Rate(5.0)}) == np.inf


@pytest.mark.parametrize("name", ["servo", "small"])
def test_what_is_certified_after_lost_rows_is_right(name, tmp_path, monkeypatch):
    """Also the speed: the loop starts again, since the angle jumps by what was lost."""
    from aslo_jax.cli import _table as tables

    motor = BY_NAME[name]
    whole = noisy(run(motor, "rich"), motor, 8, 0.002)
    log = without(without(whole, slice(2600, 2607)), slice(1500, 1530))
    speed = np.gradient(whole["angle"], whole["t"])
    keep = np.r_[0:1500, 1530:2600, 2607 : whole["t"].size]
    columns = in_alpha_beta(log)
    summary, table = estimated(tmp_path, motor, columns)
    assert [w["kind"] for w in summary["warnings"]] == ["lost_rows"]
    monkeypatch.setattr(tables, "PIECE", 508)
    _, pieces = estimated(tmp_path, motor, columns)
    for of in ("coasting", "coasting_speed"):
        np.testing.assert_array_equal(pieces[of], table[of])
    error = np.abs(table["flux_alpha"] + 1j * table["flux_beta"] - log["flux"])
    off = np.abs(table["omega_electrical"] - speed[keep]) / motor.speed
    np.testing.assert_allclose(
        pieces["omega_electrical"], table["omega_electrical"], atol=1e-6 * motor.speed
    )
    for first in (1500, 2570):
        after = slice(first, first + 400)
        trusted = table["coasting"][after] == 0
        assert trusted.any() and not trusted[:8].any()
        assert error[after][trusted].max() < 0.06 * motor.psi
        trusted = table["coasting_speed"][after] == 0
        assert trusted.any() and not trusted[:8].any()
        assert off[after][trusted].max() < 0.05
