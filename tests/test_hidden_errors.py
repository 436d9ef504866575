"""Errors of a record that another value of a parameter hides, as it enters nonlinearly."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from machine_records import motor_log

import aslo_jax as aslo
from aslo_jax.tune import calibrate
from aslo_jax.tune._calibration.adequacy import Finding, findings, undecided
from aslo_jax.tune._calibration.alternatives import (
    CERTAIN,
    Alternative,
    together,
    widened,
)
from aslo_jax.tune._calibration.profile import Profile

TRUTH = {"resistance": 6.4, "inductance": 26e-3, "magnet_flux": 0.16}
MOTOR = aslo.plants.PMSM(6.4, 26e-3, 0.16, 4, 1e-4)


def found_without_direct_current(late: bool):
    """A calibration from a log whose voltage is a sample late, or right."""
    where = lambda p: (p.resistance, p.inductance, p.magnet_flux)
    off = [x * f for x, f in zip(TRUTH.values(), (1.1, 0.9, 1.05), strict=True)]
    t, u, y = motor_log(
        MOTOR, 190.0, lambda t: 0.0 * t, lambda t: 1.2 * (1 + 0.4 * jnp.sin(150 * t)),
        2e-4, 1000, 1.5e-3, 5,
    )  # fmt: skip
    if late:
        u = np.concatenate([u[:1], u[:-1]])
    return calibrate(eqx.tree_at(where, MOTOR, off), t, u, y, where)


@pytest.mark.slow
def test_a_delay_that_looks_like_another_inductance_is_found():
    found = found_without_direct_current(late=True)
    assert abs(found.estimate["inductance"] / TRUTH["inductance"] - 1) > 0.1
    assert found.findings[0].field == "delay"
    assert found.findings[0].size == pytest.approx(1.0, rel=0.2)
    assert "a delay of the inputs" in found.withdrawn
    assert all(np.isnan(x).all() for x in found.interval.values())


@pytest.mark.slow
def test_intervals_of_a_right_record_allow_for_a_delay_that_may_be_there():
    found = found_without_direct_current(late=False)
    assert not found.withdrawn and not found.findings
    assert np.isnan(found.after["inductance"])
    for name in ("resistance", "magnet_flux"):
        low, high = found.interval[name]
        assert low < TRUTH[name] < high
        assert found.determined(name)
        assert "delay" in found.allowed[name]


def test_a_test_that_correlated_errors_leave_undecided_is_told():
    """An offset of two outputs that explains a share of 2000 errors: 20 of them or more a
    degree of freedom are no chance in white ones."""
    scored = lambda statistic, share: Finding(
        "output_offset", np.ones(2), statistic, share, np.zeros(1)
    )
    assert not undecided(2000, [scored(3.0, 0.003)])  # 3 a degree of freedom: chance
    assert undecided(2000, [scored(3.0, 0.003), scored(3.0, 0.02)])
    found = scored(30.0, 0.02)  # beyond doubt whatever is left
    assert not undecided(2000, [found])
    assert findings([scored(3.0, 0.02), found]) == (found,)


def other(field, place, deviation, statistic, share=0.1, doubt=0.0):
    finding = Finding(field, np.ones(1), statistic, share, np.array([-place]))
    return Alternative(finding, np.array([place]), np.array([deviation]), np.array([doubt]))


def test_an_interval_holds_whichever_alternative_is_right():
    """It reaches as far as the furthest of them, in closed form: half of the mass of a
    chi-squared distribution of two degrees of freedom is within `2 log 2`."""
    own = Profile(np.zeros(1), np.zeros(1), -0.05, 0.05, True)
    reach = np.sqrt(2 * np.log(2))
    near = other("dead_time", 0.025, 0.005, 1.0)
    far = other("delay", -0.025, 0.07, 1.0, doubt=0.0125)
    (same,) = widened([own], [near], 0.5)
    assert (same.low, same.high, same.allowed) == (-0.05, 0.05, ())
    (found,) = widened([own], [near, far], 0.5)
    assert found.low == pytest.approx(-0.0375 - 0.07 * reach, rel=1e-12)
    assert found.high == pytest.approx(-0.0125 + 0.07 * reach, rel=1e-12)
    assert found.allowed == ("delay",)
    # What it says of first order is nothing beyond a tenth.
    (vague,) = widened([own], [near, other("delay", 0.0, 0.09, 1.0)], 0.5)
    assert (vague.low, vague.high, vague.allowed) == (-np.inf, np.inf, ("delay",))
    (open_,) = widened([Profile(np.zeros(1), np.zeros(1), -np.inf, 1.0, False)], [far], 0.5)
    assert open_.low == -np.inf


def test_an_error_is_named_by_its_fit_where_that_is_beyond_doubt():
    score = Finding("delay", np.full(1, 0.4), 20.0, 0.01, np.zeros(1))
    assert together([score], [other("delay", 0.5, 1.0, CERTAIN - 1)]) == (score,)
    fit = other("delay", 0.5, 1.0, CERTAIN + 1)
    dead = other("dead_time", 0.5, 1.0, CERTAIN + 1, share=0.3)
    assert together([score], [fit, dead]) == (dead.finding, fit.finding)
