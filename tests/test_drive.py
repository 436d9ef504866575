"""A drive of one degree of freedom: its motion in closed form, and its parameters as an
output-error fit has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import aslo_jax as aslo
from aslo_jax.machines import MachineError, read_machine, template
from aslo_jax.tune import calibrate

DECAY, GAIN = 410.0, -52.0


def moved(decay, gain, position, velocity, h, u):
    """The angle at every instant, exactly, with u held."""
    e, found = np.exp(-decay * h), [position]
    for k in range(h.size):
        final = gain * u[k] / decay
        position += final * h[k] + (velocity - final) * (1 - e[k]) / decay
        velocity = final + (velocity - final) * e[k]
        found.append(position)
    return np.array(found)


def recorded(rows=400):
    """Uneven intervals of two time constants, steps of the input, noise of an encoder."""
    rng = np.random.default_rng(3)
    h = 0.004 + 0.002 * rng.random(rows - 1)
    u = np.repeat(rng.normal(size=rows // 5), 5)
    q = moved(DECAY, GAIN, 0.3, 0.5, h, u) + 2e-5 * rng.standard_normal(rows)
    return np.concatenate([[0.0], np.cumsum(h)]), u, q


@pytest.mark.slow
def test_parameters_are_those_of_an_output_error_fit():
    """With noise of the output alone both are the estimate of greatest likelihood."""
    t, u, q = recorded()
    start = np.array([500.0, -40.0, 0.3, 1.0])
    reference = least_squares(
        lambda p: moved(*(p * start), np.diff(t), u) - q, np.ones(4), method="lm"
    )
    variance = np.sum(reference.fun**2) / (t.size - 4)
    cover = variance * np.linalg.inv(reference.jac.T @ reference.jac)
    deviation = np.sqrt(np.diag(cover)) * np.abs(start)
    drive = aslo.plants.Drive(500.0, -40.0)
    angle = np.mod(q, 2 * np.pi)[:, None]
    found = calibrate(drive, t, u[:, None], angle, lambda d: (d.decay, d.gain))
    assert found.reason == "it settled" and not found.withdrawn
    for k, (name, true) in enumerate({"decay": DECAY, "gain": GAIN}.items()):
        best = reference.x[k] * start[k]
        assert abs(found.estimate[name] - best) < 0.2 * deviation[k], name
        assert found.half_width(name) == pytest.approx(1.96 * deviation[k], rel=0.5)
        assert abs(best - true) < 4 * deviation[k]


def test_its_acceleration():
    drive, x = aslo.plants.Drive(3.0, 7.0), aslo.plants.MechanicalState
    rate = drive.vector_field(
        jnp.zeros(()), x(jnp.array([1.0]), jnp.array([2.0])), jnp.array([5.0])
    )
    assert float(rate.velocity[0]) == pytest.approx(7.0 * 5.0 - 3.0 * 2.0)
    slope = jax.jacfwd(lambda d: d.acceleration(*2 * [jnp.ones(1)], jnp.ones(1))[0])(drive)
    assert (float(slope.decay), float(slope.gain)) == (-1.0, 1.0)


def test_its_description(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(template("drive"))
    machine = read_machine(path)
    assert isinstance(machine.plant(), aslo.plants.Drive)
    assert machine.signals.inputs == ("u1",) and machine.signals.outputs == ("q1",)
    path.write_text('[machine]\nkind = "drive"\ndecay = 400.0\ngain = 0.0\n')
    with pytest.raises(MachineError, match=r"machine\.gain"):
        read_machine(path)
