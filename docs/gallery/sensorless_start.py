"""Starting a motor without an angle.

A motor without saliency shows no angle at rest. So it is started by force: a current
along a known direction aligns the rotor and turns it up, until the flux is observable;
then the drive is fed the angle and speed of a phase-locked loop on the estimated flux.
(Method: closed loops.)
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, ForcedStart, MotorFeedback

jax.config.update("jax_enable_x64", True)
motor = aslo.plants.PMSM.bmp0701f()
flux = aslo.AlgebraicObserver(
    motor.flux_relation(), aslo.LowPass(30.0), guard=aslo.Guard(1e-3), initial=[0.2, 0.0]
)
angle = aslo.Staged(
    flux,
    aslo.PhaseLockedLoop(1000.0),
    lambda u, y, e: (u, jnp.arctan2(*(e.value - motor.inductance * y)[::-1])),
)


def speed(t):  # rad/s
    return 2.0 + 0.5 * jnp.sin(t)


def sensorless(y, x, estimates):
    found = estimates["ASLO"]["second"].value
    return MotorFeedback(current=y, angle=found[0], speed=found[1] / 5)


start = ForcedStart(
    FieldOriented(motor, speed, current_limit=2.4, voltage_limit=200.0),
    current=2.3,
    speed=3.0,
    acceleration=5.0,
)
loop = aslo.Experiment(
    motor, start, {"ASLO": angle}, interval=1e-4, feedback=sensorless, plant_steps=2
)
run = loop.run(steps=30_000, every=50)
found = run.estimates["ASLO"]["second"].value[:, 1] / 5

figure = Figure(figsize=(7.2, 3.2), layout="constrained")
axes = figure.subplots()
axes.plot(run.t, found, color="#D55E00", linewidth=0.8, label="estimated")
axes.plot(run.t, run.x.speed, label="speed")
axes.plot(run.t, speed(run.t), "k--", linewidth=1, label="reference")
axes.axvline(float(start.handover), color="0.6", linewidth=1)
axes.text(float(start.handover) + 0.02, 0.2, "the loop is closed", color="0.4")
axes.set(xlabel="t (s)", ylabel="rad/s", ylim=(-1, 4.5))
axes.legend(ncols=3, loc="upper left")
locked = run.t > start.handover + 0.3
off = jnp.abs(run.x.speed - speed(run.t))[locked].max()
headline = "Largest speed error without a sensor", 1e3 * off, "mrad/s"
