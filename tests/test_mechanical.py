"""Mechanical systems: their equations of motion, energy, and what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings, strategies as st
from mechanisms import STARTS, SYSTEMS, Held, accurate, state

from aslo_jax.plants import (
    BallBeam,
    InertiaWheelPendulum,
    MechanicalSystem,
    RoboticLeg,
)

number = st.floats(-2.0, 2.0)


def accelerations(system, position, velocity, u):
    q, v, u = (np.asarray(x, float) for x in (position, velocity, u))
    return np.asarray(system.acceleration(*map(jnp.asarray, (q, v, u))))


@settings(max_examples=50, deadline=None)
@given(st.lists(number, min_size=8, max_size=8), st.floats(0.3, 3.0), st.floats(0.3, 3.0))
def test_the_leg_moves_as_printed(numbers, m1, m2):
    """Paper, eq. (rlsys)."""
    q, v, u = np.split(np.array(numbers), [3, 6])
    q[0] = 0.4 + abs(q[0])
    expected = [
        q[0] * v[1] ** 2 + u[0] / m1,
        (-2 * m1 * q[0] * v[0] * v[1] + u[1]) / (m1 * q[0] ** 2),
        -u[1] / m2,
    ]
    found = accelerations(RoboticLeg(m1, m2), q, v, u)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.lists(number, min_size=5, max_size=5), st.floats(0.3, 3.0), st.floats(0.3, 12.0))
def test_the_ball_moves_as_printed(numbers, length, gravity):
    """Paper, eq. (bbsys)."""
    q, v, u = np.split(np.array(numbers), [2, 4])
    expected = [
        q[0] * v[1] ** 2 - gravity * np.sin(q[1]),
        (-2 * q[0] * v[0] * v[1] - gravity * q[0] * np.cos(q[1]) + u[0])
        / (length**2 + q[0] ** 2),
    ]
    found = accelerations(BallBeam(length, gravity), q, v, u)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


def arm(q):
    """A planar arm of two links, its inertia not diagonal."""
    c = jnp.cos(q[1])
    return jnp.array([[2.0 + 0.9 * c, 0.4 + 0.45 * c], [0.4 + 0.45 * c, 0.4]])


def test_coriolis_forces_against_christoffel_symbols():
    """Of an inertia that is not diagonal, by a naive loop over its slopes."""
    system = MechanicalSystem(
        arm,
        lambda q: 3.0 * jnp.sin(q[0]) + jnp.sin(q[0] + q[1]),
        lambda q: jnp.array([[1.0], [0.5]]),
        position=[0.1, 0.2],
        friction=lambda q: jnp.array([0.3, 0.1]),
    )
    rng = np.random.default_rng(1)
    for _ in range(3):
        q, v, u = rng.normal(size=2), rng.normal(size=2), rng.normal(size=1)
        slope = np.asarray(jax.jacfwd(arm)(jnp.asarray(q)))  # [i, j, k] = dM_ij/dq_k
        coriolis = np.zeros(2)
        for i in range(2):
            for j in range(2):
                for k in range(2):
                    symbol = slope[i, j, k] + slope[i, k, j] - slope[j, k, i]
                    coriolis[i] += 0.5 * symbol * v[j] * v[k]
        both = np.cos(q[0] + q[1])
        weight = np.array([3.0 * np.cos(q[0]) + both, both])
        net = np.array([1.0, 0.5]) * u - weight - coriolis - np.array([0.3, 0.1]) * v
        expected = np.linalg.solve(np.asarray(arm(q)), net)
        np.testing.assert_allclose(accelerations(system, q, v, u), expected, rtol=1e-11)


def test_against_scipy():
    """The pendulum with a wheel, its axle's friction between the two."""
    I1, I2, W, d1, d2 = 0.05, 0.01, 1.1, 0.02, 0.004
    system = InertiaWheelPendulum(I1, I2, W, [d1, d2])

    def rate(t, x):
        axle = d2 * (x[3] - x[2])
        u = 0.05 * np.sin(2 * t)
        first = (W * np.sin(x[0]) - u - d1 * x[2] + axle) / I1
        return [x[2], x[3], first, (u - axle) / I2]

    start = [2.6, 0.3, 0.5, -2.0]
    ts = np.linspace(0.5, 3.0, 6)
    solution = scipy.integrate.solve_ivp(
        rate, (0, 3), start, "DOP853", ts, rtol=1e-12, atol=1e-12
    )
    found = accurate(system, Held("wheel"), {}, STARTS["wheel"], jnp.asarray(ts))
    ours = np.hstack([found.x.position, found.x.velocity])
    np.testing.assert_allclose(ours, solution.y.T, atol=1e-9)


@pytest.mark.parametrize("name", SYSTEMS)
def test_energy_is_conserved_and_balanced(name):
    """Conserved without friction and input; else `dE/dt = v'G u - v'R v`."""
    system, start = SYSTEMS[name], STARTS[name]
    x, u = start, system.no_input(start.position)
    energy = float(system.energy(x))
    rate = eqx.filter_jit(system.vector_field)

    def field(t, s):
        position, velocity = np.split(s, 2)
        found = rate(0.0, state(position, velocity), u)
        return np.concatenate([found.position, found.velocity])

    span = 0.4 if name == "pendulum" else 1.0  # before it falls through its pivot
    flat = np.concatenate([x.position, x.velocity])
    solution = scipy.integrate.solve_ivp(
        field, (0, span), flat, "DOP853", rtol=1e-11, atol=1e-11
    )
    end = state(*np.split(solution.y[:, -1], 2))
    assert np.abs(end.position - x.position).max() > 0.1
    np.testing.assert_allclose(system.energy(end), energy, rtol=1e-9)

    u = jnp.arange(1.0, 1.0 + u.shape[0])
    tangent = system.vector_field(0.0, x, u)
    _, power = jax.jvp(system.energy, (x,), (tangent,))
    G, R = system.input_matrix(x.position), system.friction(x.position)
    np.testing.assert_allclose(power, x.velocity @ (G @ u - R @ x.velocity), rtol=1e-10)


def test_friction_takes_power():
    leg = RoboticLeg(2.0, 3.0, [0.4, 0.5, 0.6])
    x = STARTS["leg"]
    _, power = jax.jvp(leg.energy, (x,), (leg.vector_field(0.0, x, jnp.zeros(2)),))
    expected = -np.sum(np.array([0.4, 0.5, 0.6]) * np.asarray(x.velocity) ** 2)
    np.testing.assert_allclose(power, expected, rtol=1e-12)


def test_functions_can_have_parameters_that_are_learnt():
    class Bob(eqx.Module):
        mass: jax.Array

        def __call__(self, q):
            return jnp.stack([self.mass, self.mass * q[0] ** 2])

    system = MechanicalSystem(Bob(jnp.asarray(1.5)), position=[1.0, 0.0])
    x = state([1.1, 0.2], [0.3, 0.7])
    slope = eqx.filter_grad(lambda s: s.energy(x))(system)
    np.testing.assert_allclose(slope._inertia.mass, 0.5 * (0.3**2 + 1.1**2 * 0.7**2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(position=1.0), r"`position` must have the shape \(n,\)"),
        (dict(angles=(True,)), "`angles` must have one entry for each of the 2 coord"),
        (
            dict(inertia=lambda q: q[0]),
            r"`inertia` must return the shape \(2, 2\) or \(2,\)",
        ),
        (dict(potential=lambda q: q), r"`potential` must return the shape \(\) for 2"),
        (dict(input_matrix=lambda q: q), r"`input_matrix` must return the shape \(2, m\)"),
        (dict(friction=lambda q: q[:1]), r"`friction` must return the shape"),
    ],
)
def test_functions_of_wrong_shape_are_refused(change, message):
    arguments = dict(inertia=lambda q: jnp.ones(2), position=[0.0, 0.0]) | change
    with pytest.raises(ValueError, match=message):
        MechanicalSystem(**arguments)


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"`m2` must be positive and finite \(kg m\^2\)"):
        RoboticLeg(1.0, 0.0)
    with pytest.raises(ValueError, match="`damping` must be finite and not negative"):
        BallBeam(1.0, damping=[0.1, -0.1])
