"""The drive of a synchronous reluctance motor, with an angle sensor and without."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import plants
from aslo_jax.control import MotorFeedback, ReluctanceDrive
from aslo_jax.disturbances import SampledNoise

pytestmark = pytest.mark.slow
REFERENCE, LOAD = 80.0, 6.0  # rad/s, N m


@pytest.fixture(scope="module")
def driven():
    """A reluctance motor whose drive is fed its true angle and speed, for a second."""
    motor = plants.SynchronousReluctance(load=lambda t: LOAD + 0.0 * t)
    drive = ReluctanceDrive(motor, lambda t: REFERENCE + 0.0 * t, 8.0, 15.0)
    flux = aslo.derive(motor).observer(aslo.LowPass(40.0))
    feed = lambda y, x, e: MotorFeedback(y, motor.pole_pairs * x.angle, x.speed)
    record = aslo.Experiment(
        motor, drive, {"flux": flux}, 1e-4, feedback=feed, plant_steps=2
    ).run(12_000, 20)
    return motor, drive, record


def test_a_reluctance_drive_carries_its_load(driven):
    """The current across the iron is the load over the constant of torque."""
    motor, drive, record = driven
    last = jax.tree.map(lambda x: x[-1], record.x)
    assert abs(float(last.speed) - REFERENCE) < 1e-2
    theta = motor.pole_pairs * last.angle
    current = aslo.control.rotate(-theta, record.y[-1])
    wanted = [8.0, LOAD / (1.5 * 2 * (41.5e-3 - 6.2e-3) * 8.0)]
    # A held voltage lags the turning frame by half a sample.
    np.testing.assert_allclose(current, wanted, rtol=2e-2)
    currents = np.linalg.norm(record.y, axis=1)
    assert currents.max() < 1.05 * np.hypot(8.0, 15.0)
    np.testing.assert_allclose(drive.torque_constant, LOAD / wanted[1])


def test_its_flux_and_its_angle_are_found(driven):
    motor, _, record = driven
    found = record.estimates["flux"].value[300:]
    assert np.abs(found - record.hidden[300:]).max() < 2e-3  # Wb, of 0.35
    across = motor.active_flux(found, record.y[300:])
    theta = motor.pole_pairs * record.x.angle[300:]
    error = aslo.observers.wrap(jnp.arctan2(across[:, 1], across[:, 0]) - theta)
    assert np.abs(error).max() < 0.02


def test_it_turns_without_an_angle_sensor():
    """From standstill, its flux known there, through a step of the load, on noise: angle
    and speed are those of a phase-locked loop on the derived flux."""
    motor = plants.SynchronousReluctance(load=lambda t: jnp.where(t < 0.6, 2.0, 8.0))
    drive = ReluctanceDrive(
        motor,
        lambda t: 100.0 * jnp.clip(t / 0.5, 0.0, 1.0),
        8.0,
        20.0,
        speed_bandwidth=20.0,
    )
    zero = jnp.zeros(())
    first = plants.MachineState(jnp.array([8.0 * 41.5e-3, 0.0]), zero, zero)
    flux = aslo.derive(motor).observer(
        aslo.LowPass(40.0), gain=40.0, guard=aslo.Guard(1e-3), initial=first.flux
    )

    def iron(u, y, estimate):
        across = motor.active_flux(estimate.value, y)
        return u, jnp.arctan2(across[1], across[0])

    def feed(y, x, estimates):
        angle, speed = estimates["drive"]["second"].value
        return MotorFeedback(y, angle, speed / motor.pole_pairs)

    record = aslo.Experiment(
        motor,
        drive,
        {"drive": aslo.Staged(flux, aslo.PhaseLockedLoop(150.0), iron)},
        1e-4,
        feedback=feed,
        sensor=SampledNoise(0.05, 1e-4, aslo.random.key(3)),
        initial=first,
        plant_steps=2,
    ).run(15_000, 50)
    found = record.estimates["drive"]
    error = found["second"].value[:, 0] - motor.pole_pairs * record.x.angle
    assert np.abs(aslo.observers.wrap(error)).max() < 0.2  # rad, as it begins to turn
    assert np.abs(aslo.observers.wrap(error))[100:].max() < 0.05
    assert abs(float(record.x.speed[-1]) - 100.0) < 0.5
    assert np.asarray(found["first"].coasting)[:10].all()  # nothing to see at standstill
    assert not np.asarray(found["first"].coasting)[100:].any()
