"""Observers that copy a plant, and controllers that are placed: against poles and closed
forms of linear ones, and what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from accurate import simulated

import aslo_jax as aslo
from aslo_jax import plants
from aslo_jax.control import OpenLoop, StateFeedback
from aslo_jax.observers import (
    ExtendedKalman,
    Luenberger,
    MachineModel,
    PlantModel,
    PMSMModel,
)

BANDWIDTH = 300.0
# Speed, load and current of the DC motor with its default numbers.
A = np.array(
    [
        [-1e-5 / 1e-4, -1 / 1e-4, 0.05 / 1e-4],
        [0.0, 0.0, 0.0],
        [-0.05 / 0.6e-3, 0.0, -0.6 / 0.6e-3],
    ]
)
C = np.array([[0.0, 0.0, 1.0]])


def voltage(t):
    return jnp.stack([12.0 + 4.0 * jnp.sin(30.0 * t)])


def test_the_poles_are_placed():
    gain = np.asarray(Luenberger.of_plant(plants.DCMotor(), BANDWIDTH).gain)
    poles = np.sort(np.linalg.eigvals(A - gain @ C).real)
    np.testing.assert_allclose(poles, -BANDWIDTH * np.array([1.25, 1.0, 0.8]), rtol=1e-6)


STARTS = jnp.array([40.0, 1.0])  # speed and current, of which the copy knows nothing
ERROR = np.array([0.0 - 40.0, 0.1 - 0.3, 0.0 - 1.0])


@pytest.fixture(scope="module")
def copied():
    """A motor, a copy that takes another load, and how their difference decays."""
    observer = Luenberger.of_plant(plants.DCMotor(load=0.1), BANDWIDTH)
    decay = A - np.asarray(observer.gain) @ C
    return (
        plants.DCMotor(load=0.3),
        observer,
        lambda t: (scipy.linalg.expm(decay * float(t)) @ ERROR)[:2],
    )


def test_the_error_of_a_linear_plant_decays_by_its_exponential(copied):
    motor, observer, exact = copied
    ts = jnp.array([1e-3, 3e-3, 1e-2])
    run = simulated(motor, OpenLoop(voltage), {"o": observer}, STARTS, ts)
    wanted = [exact(t) for t in ts]
    np.testing.assert_allclose(run.error("o"), wanted, rtol=1e-7, atol=1e-8)


def test_a_sampled_copy_is_of_second_order(copied):
    """By the straight line from sample to sample."""
    motor, observer, exact = copied

    def error(h):
        loop = aslo.Experiment(motor, OpenLoop(voltage), {"o": observer}, h, initial=STARTS)
        steps = round(0.01 / h)
        record = loop.run(steps, steps)
        return (record.estimates["o"].value - record.hidden)[-1] - exact(0.01)

    order = np.log2(np.abs(error(2e-4) / error(1e-4)))
    np.testing.assert_allclose(order, 2.0, atol=0.05)


def test_it_is_refused_where_the_plant_is_not_observable():
    with pytest.raises(ValueError, match="must be observable where it is held"):
        Luenberger.of_plant(plants.Lorenz(), 10.0, jnp.zeros(3))
    with pytest.raises(ValueError, match="`bandwidth` must be positive"):
        Luenberger.of_plant(plants.DCMotor(), -1.0)
    with pytest.raises(ValueError, match="must hold numbers, but are being"):
        jax.jit(lambda b: Luenberger.of_plant(plants.DCMotor(), b).gain)(1.0)
    with pytest.raises(ValueError, match=r"`gain` must have shape \(n, p\)"):
        Luenberger(PlantModel(plants.DCMotor()), jnp.ones((2, 1)), jnp.ones(3))


def test_unknown_parameters_are_states_of_the_model():
    car = plants.LateralVehicle()
    model = PlantModel(car)
    x = model.joined(jnp.array([0.4, 0.1, 22.0, 0.02]))
    np.testing.assert_array_equal(x, [0.4, 0.3, 0.1, 22.0, 0.02])
    u = jnp.array([0.5, 0.03])
    other = x.at[1].set(-0.2)
    np.testing.assert_allclose(model.output(other)[1], model.output(x)[1] - 0.5)
    # What the car does is not what its accelerometer says.
    np.testing.assert_allclose(model.drift(other, u), model.drift(x, u), rtol=1e-12)
    plant, state = model.at(other)
    moved = plant.vector_field(jnp.zeros(()), state, u)
    np.testing.assert_array_equal(model.drift(other, u)[jnp.array([0, 2, 3, 4])], moved)
    np.testing.assert_array_equal(model.select(other), plant.hidden(state))


def test_the_model_of_a_machine_is_that_of_a_pmsm():
    motor = plants.PMSM.bmp0701f()
    general, special = MachineModel(motor), PMSMModel(motor.flux_relation())
    x, u = jnp.array([0.1, -0.15, 70.0, 2.3]), jnp.array([3.0, -8.0])
    np.testing.assert_allclose(general.output(x), special.output(x), rtol=1e-13)
    np.testing.assert_allclose(general.drift(x, u), special.drift(x, u), rtol=1e-13)
    np.testing.assert_array_equal(general.select(x), x[:2])


def test_intensities_of_a_kalman_filter_are_over_ranges():
    filter = ExtendedKalman.of_plant(plants.DCMotor(load=-0.2), 4.0, 9.0, 1e-6)
    np.testing.assert_allclose(np.diag(filter.process), [4 * 400**2, 9 * 0.01, 4 * 10**2])
    np.testing.assert_allclose(np.diag(filter.covariance), [400**2, 0.01, 10**2])
    np.testing.assert_allclose(filter.initial, [0.0, -0.2, 0.0])
    with pytest.raises(ValueError, match="`drift` must be positive"):
        ExtendedKalman.of_plant(plants.DCMotor(), 1.0, 0.0, 1e-6)
    machine = plants.SynchronousReluctance()
    with pytest.raises(ValueError, match="`voltage` must be positive"):
        ExtendedKalman.of_machine(machine, 0.0, 1.0, 1.0, flux=jnp.array([0.1, 0.0]))


def test_state_feedback_places_the_poles_of_levitation():
    ball = plants.Levitation()
    control = StateFeedback.of_plant(ball, 60.0, jnp.zeros_like)
    # By hand: flux, speed and distance about 10 mm with the flux that carries the weight.
    k, m, R, q = 1.2e-4, 0.06, 5.0, 0.01
    flux = np.sqrt(2 * k * m * 9.81)
    np.testing.assert_allclose(control.hold, [R * q * flux / k], rtol=1e-5)
    held = np.array([[-R * q / k, 0, -R * flux / k], [-flux / (k * m), 0, 0], [0, 1.0, 0]])
    back = jax.jacfwd(lambda x: control(jnp.zeros(()), None, x))(control.centre)
    closed = held + np.array([[1.0], [0], [0]]) @ np.asarray(back)
    poles = np.sort(np.linalg.eigvals(closed).real)
    np.testing.assert_allclose(poles, -60.0 * np.array([1.25, 1.0, 0.8]), rtol=1e-4)
    with pytest.raises(ValueError, match=r"`gain` must have shape \(1, 3\)"):
        eqx.tree_at(lambda c: c.gain, control, jnp.ones((1, 2))).__check_init__()
