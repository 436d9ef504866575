"""A leg that sways on estimated velocities.

An extensible leg on a body. Its length and angle follow a reference, by a controller
that is fed positions and *estimated* velocities. Drawn are the leg and the velocity of
its foot: true (grey) and estimated (blue), as an arrow.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import MechanicalFeedback, Tracking

jax.config.update("jax_enable_x64", True)
leg = aslo.plants.RoboticLeg(m1=2.0, m2=3.0)  # kg, kg m^2


def sway(t):  # m, rad
    return jnp.stack([1.0 + 0.2 * jnp.sin(2 * t), 0.6 * jnp.sin(2.6 * t)])


moving = aslo.plants.MechanicalState(
    position=jnp.array([1.0, 0.4, -0.3]), velocity=jnp.array([0.2, 1.0, -0.5])
)
loop = aslo.Experiment(
    leg,
    Tracking(leg, sway, tracked=(0, 1), bandwidth=4.0),
    {"ASLO": aslo.velocity_observer(leg, aslo.LowPass(10.0))},
    1e-3,
    feedback=lambda y, x, e: MechanicalFeedback(position=y, velocity=e["ASLO"].value),
    initial=moving,
)
run = loop.run(4_800, every=60)
length, angle, body = np.asarray(run.x.position).T


def foot_velocity(v):
    """Of the foot, in m/s, from the rates of length and angle."""
    out, across = (
        np.array([np.sin(angle), -np.cos(angle)]),
        np.array([np.cos(angle), np.sin(angle)]),
    )
    return v[:, 0] * out + length * v[:, 1] * across


true = foot_velocity(np.asarray(run.hidden))
found = foot_velocity(np.asarray(run.estimates["ASLO"].value))
foot = length * np.array([np.sin(angle), -np.cos(angle)])

figure = Figure(figsize=(3.6, 3.6), layout="constrained")
axes = figure.subplots()
axes.set(xlim=(-1.1, 1.1), ylim=(-1.6, 0.6), xlabel="m", ylabel="m")
axes.set_aspect("equal")
(torso,) = axes.plot([], [], color="0.4", linewidth=10, solid_capstyle="round")
(limb,) = axes.plot([], [], color="black", linewidth=4, solid_capstyle="round")
(grey,) = axes.plot([], [], color="0.75", linewidth=6)
(blue,) = axes.plot([], [], color="#0072B2", linewidth=2)
frames = len(run.t)


def draw(frame):
    turn = np.array([np.cos(body[frame]), np.sin(body[frame])])
    torso.set_data(*np.stack([-0.3 * turn, 0.3 * turn], axis=1))
    limb.set_data([0, foot[0, frame]], [0, foot[1, frame]])
    for line, v in ((grey, true), (blue, found)):
        ends = np.stack([foot[:, frame], foot[:, frame] + 0.5 * v[:, frame]], axis=1)
        line.set_data(*ends)


error = np.abs(np.asarray(run.estimates["ASLO"].value) - run.hidden)[1:].max()
headline = "Largest velocity error", 1e6 * error, "µm/s or µrad/s"
