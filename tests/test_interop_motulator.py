"""Results of motulator as logs, and an observer of ours behind its protocol: of a recorded
run, and of motulator itself where it is installed."""

import copy
import dataclasses
from math import pi

import jax.numpy as jnp
import motulator_drive as drive
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import interop
from aslo_jax.logs import LogError


@pytest.fixture(scope="module")
def log():
    return interop.from_motulator(drive.recorded())


def tracker():
    relation = aslo.plants.FluxRelation(
        drive.RESISTANCE, drive.INDUCTANCE, drive.MAGNET_FLUX
    )
    start = jnp.array([drive.MAGNET_FLUX, 0.0])  # the angle zero, as motulator assumes
    flux = aslo.AlgebraicObserver(relation, aslo.LowPass(60.0), initial=start)
    return aslo.observers.track_angle(flux, 2 * pi * 50, drive.INDUCTANCE)


def flux_of(log):
    return np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)


def unexplained(log, u):
    """The largest voltage that the machine does not account for (V), by the trapezoidal
    rule for the resistive drop."""
    dt = np.diff(log.t)[:, None]
    drop = drive.RESISTANCE * (log.y[1:] + log.y[:-1]) / 2
    return np.nanmax(np.abs(np.diff(flux_of(log), axis=0) / dt + drop - u))


def test_the_voltage_of_a_row_is_held_from_it_on(log):
    assert np.max(np.abs(log.u)) > 100.0
    # R i'' h^2/12, of a current of 10 A that settles at 1,000 1/s.
    assert unexplained(log, log.u[:-1]) < 0.3
    assert unexplained(log, log.u[1:]) > 10.0
    magnet = flux_of(log) - drive.INDUCTANCE * log.y
    angle = log.truth["theta_electrical"]
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(magnet, drive.MAGNET_FLUX * turn, atol=1e-9)
    # Of the mechanical speed the electrical angle is the integral times the pole pairs.
    speed = log.truth["omega_mechanical"]
    mean = np.diff(angle) / np.diff(log.t) / drive.POLE_PAIRS
    np.testing.assert_allclose(mean, (speed[1:] + speed[:-1]) / 2, atol=5e-3)


def test_a_file_of_what_is_read_gives_the_same_log(log, tmp_path):
    results = drive.recorded()
    # The model has more instants than the controller, and each of its own twice.
    later = results.mdl.t + 0.3 * drive.PERIOD
    order = np.argsort(np.concatenate([results.mdl.t] * 2 + [later]), kind="stable")
    for of, name in (
        (results.mdl, "t"),
        *((results.mdl.machine, name) for name in ("psi_s_ab", "theta_m", "w_M")),
    ):
        x = getattr(of, name)
        between = later if name == "t" else 0.0 * x
        setattr(of, name, np.concatenate([x, x, between])[order])
    path = tmp_path / "run.npz"
    interop.save_motulator(results, path)
    for found in (interop.from_motulator(path), interop.from_motulator(str(path))):
        np.testing.assert_array_equal(found.u, log.u)
        for name, x in log.truth.items():
            np.testing.assert_array_equal(found.truth[name], x)


def test_its_flux_is_observed(log):
    estimate = aslo.replay(tracker(), log.t, log.u, log.y)
    later = slice(200, None)
    error = np.abs(estimate["first"].value - flux_of(log))[later]
    assert np.max(error) < 0.01 * drive.MAGNET_FLUX
    assert not estimate["first"].coasting[later].any()


def test_voltages_of_blocked_gates_are_missing():
    blocked = drive.recorded()
    blocked.ctrl.ref.enabled[40:50] = False
    with pytest.raises(LogError, match="row 40"):
        interop.from_motulator(blocked)
    log = interop.from_motulator(blocked, missing="coast")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(log.u[:, 1])), np.arange(40, 51))
    assert np.isfinite(log.y).all()


def test_results_of_another_structure_are_refused():
    for change, said in (
        (lambda r: delattr(r.ctrl, "fbk"), "no `ctrl.fbk`; of a composite model"),
        (lambda r: delattr(r.ctrl.fbk, "u_s_zoh"), "no `ctrl.fbk.u_s_zoh`"),
        (lambda r: setattr(r.mdl, "lc_filter", r.mdl), "without an LC filter"),
        (lambda r: setattr(r.mdl, "t", r.mdl.t + 1e-5), "instants of the controller"),
    ):
        results = copy.deepcopy(drive.recorded())
        change(results)
        with pytest.raises(ValueError, match=said):
            interop.from_motulator(results)


def test_behind_the_protocol_is_replay(log):
    """Fed as motulator feeds it: with the voltage of the period that begins. From where it
    turns: as it starts certificates are 1e-11, and what rounding does to angles 1e-6."""
    observer = tracker()
    behind = interop.MotulatorObserver(observer, drive.POLE_PAIRS, drive.MAGNET_FLUX)
    given_u, given_y = log.u[200:], log.y[200:]
    rows = 120
    lost = range(60, 63)
    flux, angle, speed = [], [], []
    for k in range(rows):
        u = None if k in lost else complex(*given_u[k])
        out = behind.compute_output(u, complex(*given_y[k]))
        assert behind.compute_output(u, complex(*given_y[k])) == out  # a look is no step
        turn = np.exp(1j * out.theta_c)
        np.testing.assert_allclose(turn * out.i_s, complex(*given_y[k]))
        flux.append([(turn * out.psi_s).real, (turn * out.psi_s).imag])
        angle.append(behind.theta_m)
        speed.append(behind.w_M)
        behind.update(drive.PERIOD, out)
    u = given_u[:rows].copy()
    u[lost] = np.nan
    t = drive.PERIOD * np.arange(rows)
    expected = aslo.replay(observer, t, u, given_y[:rows], missing="coast")
    np.testing.assert_allclose(flux, expected["first"].value, atol=1e-11)
    wound = expected["second"].value
    turns = np.exp(1j * np.array(angle)), np.exp(1j * wound[:, 0])
    np.testing.assert_allclose(*turns, rtol=1e-11)
    np.testing.assert_allclose(np.array(speed) * drive.POLE_PAIRS, wound[:, 1], atol=1e-8)


def test_what_an_observer_behind_the_protocol_refuses():
    flux = tracker().first
    with pytest.raises(ValueError, match="followed by a phase-locked loop"):
        interop.MotulatorObserver(flux, 3, 0.5)
    with pytest.raises(ValueError, match="`sensorless=True`"):
        interop.MotulatorObserver(tracker(), 3, 0.5).compute_output(0j, 0j, 0.1, 1.0)


@pytest.mark.slow
def test_motulator_itself_gives_what_was_recorded():
    pytest.importorskip("motulator", reason="motulator, which needs Python 3.12")
    found = interop.from_motulator(drive.simulate(0.1))
    expected = interop.from_motulator(drive.recorded())
    for name in ("t", "u", "y"):
        x, y = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(x, y, atol=1e-6 * np.max(np.abs(y)))
    for name, y in expected.truth.items():
        np.testing.assert_allclose(found.truth[name], y, atol=1e-6 * np.max(np.abs(y)))


@pytest.mark.slow
def test_its_transformation_is_ours():
    """As the table of the page says."""
    utils = pytest.importorskip("motulator.common.utils", reason="needs Python 3.12")
    phases = np.array([1.0, -0.3, 0.2])
    found = utils.abc2complex(phases)
    np.testing.assert_allclose([found.real, found.imag], aslo.frames.clarke(phases))


@pytest.mark.slow
@pytest.mark.parametrize("released", [0.0, 0.004])
def test_it_closes_the_loop_of_motulator(released):
    """From standstill, also where the gates are released later: motulator's controller
    follows the angle and the speed of ours."""
    pytest.importorskip("motulator", reason="motulator, which needs Python 3.12")
    from motulator.drive.control.sm import ObserverOutputs

    behind = interop.MotulatorObserver(tracker(), drive.POLE_PAIRS, drive.MAGNET_FLUX)
    results = drive.simulate(0.3, behind, lambda t: t >= released)
    names = {field.name for field in dataclasses.fields(interop.MotulatorOutputs)}
    assert {field.name for field in dataclasses.fields(ObserverOutputs)} <= names
    log = interop.from_motulator(results, missing="coast")
    feedback, last = results.ctrl.fbk, slice(-200, None)
    off = np.exp(1j * (feedback.theta_m - log.truth["theta_electrical"]))[last]
    assert np.max(np.abs(np.angle(off))) < np.radians(1.0)
    speed = log.truth["omega_mechanical"][last]
    assert np.max(np.abs(feedback.w_M[last] - speed)) < 1.0
    np.testing.assert_allclose(speed, 2 * pi * 20, rtol=0.05)
