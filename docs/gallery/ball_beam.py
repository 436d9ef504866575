"""A ball on a beam, balanced on estimated velocities.

Positions come from encoders of 12 bits, velocities from the algebraic observer. The
ball follows a reference (the mark below the beam) although the controller never sees a
speed.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import BallBeamTracking, MechanicalFeedback
from aslo_jax.disturbances import Encoder
from aslo_jax.observers import wrap

jax.config.update("jax_enable_x64", True)
ball = aslo.plants.BallBeam(length=1.2)  # m


def reference(t):  # m
    return 0.3 * jnp.sin(1.5 * t)


def from_encoder(y, x, estimates):
    position = jnp.stack([y[0], wrap(y[1])])
    return MechanicalFeedback(position, estimates["ASLO"].value)


loop = aslo.Experiment(
    ball,
    BallBeamTracking(ball, reference),
    {"ASLO": aslo.velocity_observer(ball, aslo.LowPass(10.0))},
    1e-3,
    feedback=from_encoder,
    sensor=Encoder([1.2 / 2**12, 2 * jnp.pi / 2**12], ball.angles),
    initial=aslo.plants.MechanicalState(jnp.array([0.2, -0.1]), jnp.array([-0.2, 0.5])),
)
run = loop.run(8_400, every=100)
place, angle = np.asarray(run.x.position).T

figure = Figure(figsize=(4.4, 2.6), layout="constrained")
axes = figure.subplots()
axes.set(xlim=(-0.75, 0.75), ylim=(-0.35, 0.35), xlabel="m", ylabel="m")
axes.set_aspect("equal")
(beam,) = axes.plot([], [], color="black", linewidth=4, solid_capstyle="round")
(dot,) = axes.plot([], [], "o", color="#D55E00", markersize=14)
(mark,) = axes.plot([], [], "^", color="0.5", markersize=7)
frames = len(run.t)


def draw(frame):
    along = np.array([np.cos(angle[frame]), np.sin(angle[frame])])
    up = np.array([-along[1], along[0]])
    beam.set_data(*np.stack([-0.6 * along, 0.6 * along], axis=1))
    at = place[frame] * along + 0.055 * up
    dot.set_data(at[:1], at[1:])
    below = float(reference(run.t[frame])) * along - 0.05 * up
    mark.set_data(below[:1], below[1:])


late = np.asarray(run.t) > 4.0
off = np.abs(place - np.asarray(reference(run.t)))[late].max()
headline = "Ball off its reference after 4 s", 1e3 * off, "mm at most"
