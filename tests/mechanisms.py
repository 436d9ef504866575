"""The mechanisms of the tests, in motion: asymmetric parameters, moving from the start."""

import equinox as eqx
import jax.numpy as jnp
from accurate import simulated

import aslo_jax as aslo
from aslo_jax.plants import (
    BallBeam,
    CartOnArm,
    InertiaWheelPendulum,
    MechanicalState,
    MechanicalSystem,
    RoboticLeg,
    VariableLengthPendulum,
)


def state(position, velocity):
    return MechanicalState(jnp.asarray(position, float), jnp.asarray(velocity, float))


def general(q):
    """Two coordinates of each kind, and one in between: q3 and q4 first, then q2, whose
    inertia depends on q5, then q1 and q5, each on its own."""
    return jnp.stack(
        [
            1.3 + 0.0 * q[0],
            2.0 + 0.5 * jnp.sin(q[4]),
            0.8 + 0.3 * q[0] ** 2 + 0.2 * q[1] ** 2,
            1.1 + 0.4 * jnp.cos(q[1]),
            0.7 + 0.0 * q[0],
        ]
    )


GENERAL = MechanicalSystem(
    general,
    lambda q: 2.0 * q[0] ** 2 + 1.5 * q[1] ** 2 + q[4] ** 2 + jnp.cos(q[2]) + q[2] * q[3],
    lambda q: jnp.array([[1.0, 0.0], [0.3, 0.0], [0.0, 1.0], [0.5, -1.0], [0.2, 0.4]]),
    position=[0.3, -0.2, 0.5, 0.1, 0.4],
)

SYSTEMS = {
    "leg": RoboticLeg(2.0, 3.0),
    "ball": BallBeam(1.2),
    "cart": CartOnArm(0.7, 0.3, 9.81),
    "wheel": InertiaWheelPendulum(0.05, 0.01, 1.1),
    "pendulum": VariableLengthPendulum(1.3),
    "general": GENERAL,
}
STARTS = {
    "leg": state([1.0, 0.4, -0.3], [0.2, 1.0, -0.5]),
    "ball": state([0.1, 0.3], [-0.2, 0.6]),
    "cart": state([0.5, 0.2], [0.1, -0.4]),
    "wheel": state([2.6, 0.3], [0.5, -2.0]),
    "pendulum": state([1.0, 0.4], [0.1, 0.7]),
    "general": state([0.3, -0.2, 0.5, 0.1, 0.4], [0.4, -0.6, 0.2, 0.8, -0.3]),
}


def held(name, q, t):
    """A bounded input that keeps the mechanism in a useful range."""
    s, c = jnp.sin(2.0 * t), jnp.cos(3.0 * t)
    if name == "leg":
        return jnp.stack([-4.0 * (q[0] - 1.0) - 1.5 + s, c])
    if name == "ball":
        return jnp.stack([9.81 * q[0] - 6.0 * q[1] + s])
    if name == "cart":
        return jnp.stack([-9.0 * (q[0] - 0.5) + s, 3.0 * jnp.cos(q[1]) - 4.0 * q[1] + c])
    if name == "wheel":
        return jnp.stack([0.05 * s])
    if name == "pendulum":
        return jnp.stack([-30.0 * (q[0] - 1.0) - 1.3 * 9.81 + s])
    return jnp.stack([s, 0.7 * c])


class Held(aslo.control.AbstractController):
    """The input [`held`][], from the positions."""

    name: str = eqx.field(static=True)

    def init(self, fed):
        del fed

    def vector_field(self, t, state, fed):
        del t, state, fed

    def __call__(self, t, state, fed):
        del state
        return held(self.name, fed, t)


def accurate(system, controller, observers, start, ts):
    """The closed loop at 1e-12."""
    return simulated(system, controller, observers, start, ts)
