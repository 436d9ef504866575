"""Runs of gym-electric-motor as logs."""

import warnings

import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import interop

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the environments that it registers
    gem = pytest.importorskip("gym_electric_motor")
    from gym_electric_motor.physical_systems import (
        ConstantSpeedLoad,
        FiniteB6BridgeConverter,
        ScipySolveIvpSolver,
    )
SPEED, TAU = 200.0, 1e-4  # mechanical, rad/s


def environment(name="Cont-CC-PMSM-v0", **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gem.make(
            name,
            load=ConstantSpeedLoad(SPEED),
            ode_solver=ScipySolveIvpSolver(rtol=1e-10, atol=1e-10),
            constraints=(),
            tau=TAU,
            **settings,
        )


def run(env, rows=300, action=None):
    """Of a voltage that turns with the rotor, as the states that it returns."""

    def turning(k):
        angle = env.unwrapped.physical_system.unwrapped.electrical_motor
        angle = angle.motor_parameter["p"] * SPEED * TAU * k + 1.7
        return 0.28 * np.cos(angle - 2 * np.pi / 3 * np.arange(3))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (state, _), _ = env.reset(seed=1)
        states = [state]
        for k in range(rows):
            (state, _), *_ = env.step((action or turning)(k))
            states.append(state)
    return np.array(states)


@pytest.fixture(scope="module")
def pmsm():
    env = environment()
    return env, run(env)


def balance(log, resistance, inductive):
    """What of the voltage a machine does not account for, relative; by the trapezoidal rule
    for the resistive drop. `inductive` is its stator flux (Wb)."""
    dt = np.diff(log.t)[:, None]
    left = np.diff(inductive, axis=0) + dt * resistance * (log.y[1:] + log.y[:-1]) / 2
    return np.max(np.abs(left - dt * log.u[:-1])) / np.max(np.abs(dt * log.u[:-1]))


def test_voltages_currents_and_fluxes_of_a_motor_with_magnets_fit(pmsm):
    env, states = pmsm
    log = interop.from_gem(env, states)
    mp = env.unwrapped.physical_system.electrical_motor.motor_parameter
    flux = np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)
    # The rule is off by the curvature of the current, R i (omega tau)^2/12.
    assert balance(log, mp["r_s"], flux) < 1e-5
    late = aslo.logs.Log(log.t, np.roll(log.u, 1, axis=0), log.y, {})
    assert balance(late, mp["r_s"], flux) > 1e-2
    np.testing.assert_allclose(np.diff(log.truth["theta_electrical"]), 3 * SPEED * TAU)
    np.testing.assert_allclose(log.truth["omega_mechanical"], SPEED, rtol=1e-9)
    assert np.max(np.abs(log.y)) > 30.0


def test_its_flux_is_observed(pmsm):
    """By an observer of ours with the parameters of the environment."""
    env, states = pmsm
    mp = env.unwrapped.physical_system.electrical_motor.motor_parameter
    log = interop.from_gem(env, states)
    relation = aslo.plants.InteriorPMSM(
        mp["r_s"], mp["l_d"], mp["l_q"], mp["psi_p"], mp["p"], mp["j_rotor"]
    ).self_consistent_relation()
    observer = aslo.observers.SelfConsistent(
        relation, aslo.LowPass(300.0), 300.0, initial=np.zeros(2)
    )
    estimate = aslo.replay(observer, log.t, log.u, log.y)
    flux = np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)
    assert np.max(np.abs(estimate.value - flux)[200:]) < 0.02 * mp["psi_p"]


def test_currents_of_a_squirrel_cage_fit():
    env = environment("Cont-CC-SCIM-v0")
    log = interop.from_gem(env, run(env, 100))
    motor = env.unwrapped.physical_system.unwrapped.electrical_motor
    mp = motor.motor_parameter
    # The stator flux by its own equation: u is what drives it, and y what it loses.
    leakage = mp["l_m"] + mp["l_sigs"], mp["l_m"] + mp["l_sigr"]
    sigma = leakage[0] - mp["l_m"] ** 2 / leakage[1]
    rate = np.diff(log.y, axis=0) / TAU
    # At rest the first step has no current and no rotor flux yet.
    np.testing.assert_allclose(sigma * rate[0], log.u[0], rtol=2e-2)
    assert set(log.truth) == {"theta_electrical", "omega_mechanical"}


def test_what_is_refused(pmsm):
    env, states = pmsm
    limits = env.unwrapped.limits
    short = environment(state_filter=["omega", "i_sd", "i_sq", "epsilon"])
    switched = environment(
        "Finite-CC-PMSM-v0", converter=FiniteB6BridgeConverter(interlocking_time=1e-6)
    )
    columns = [env.unwrapped.state_names.index(n) for n in short.unwrapped.state_names]
    for other, given, said in (
        (env, states * limits, r"divided by `env.unwrapped.limits`, but epsilon, an angle"),
        (env, states[:, :4], r"shape \(N, 14\), .* has the shape \(301, 4\)"),
        (short, states[:, columns], "leave u_sd, u_sq in its `state_filter`"),
        (switched, states, "only the last voltage of an interval"),
        (environment_of_dc(), states[:, :5], "synchronous motor or a squirrel-cage"),
    ):
        with pytest.raises(ValueError, match=said):
            interop.from_gem(other, given)


def environment_of_dc():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gem.make("Cont-CC-PermExDc-v0")
