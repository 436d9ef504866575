"""Through a reversal, and standing still.

At rest nothing in voltages and currents tells of the flux. The completion of the paper
divides by a determinant that crosses zero; least squares has none to cross, its
certificate falls, and below the threshold of its guard the estimate coasts: the last
certified flux is carried along `u - R i`. The currents have 10 mA of noise.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise

jax.config.update("jax_enable_x64", True)


def speed(t):  # rad/s
    return 3.0 * jnp.clip(1.75 - t, 0.0, 1.0) - 3.0 * jnp.clip(t - 2.25, 0.0, 1.0)


motor = aslo.plants.PMSM.bmp0701f(load=lambda t: 2.0 * jnp.minimum(t, 0.5))
relation, F = motor.flux_relation(), aslo.LowPass(20.0)
observers = {
    "Repeat": aslo.AlgebraicObserver(relation, F, aslo.Repeat()),
    "least squares": aslo.AlgebraicObserver(relation, F, guard=aslo.Guard(0.02)),
}
loop = aslo.Experiment(
    motor,
    FieldOriented(motor, speed, current_limit=2.4, voltage_limit=150.0),
    observers,
    interval=1e-4,
    feedback=lambda y, x, e: MotorFeedback(y, 5 * x.angle, x.speed),
    sensor=SampledNoise(0.01, 1e-4, aslo.random.key(0)),
    plant_steps=2,
)
run = loop.run(steps=40_000, every=20)

figure = Figure(figsize=(7.2, 4.6), layout="constrained")
first, second, third = figure.subplots(3, 1, sharex=True)
first.plot(run.t, run.x.speed, color="black")
first.set(ylabel="speed (rad/s)")
errors = {}
for name, found in run.estimates.items():
    error = jnp.linalg.norm(found.value - run.hidden, axis=1) / motor.magnet_flux
    errors[name] = error[run.t > 0.5].max()
    second.semilogy(run.t[1:], error[1:], label=name, linewidth=1)
    third.semilogy(run.t[1:], found.certificate[1:], linewidth=1)
coasting = run.estimates["least squares"].coasting
for axes in (first, second, third):
    shade = axes.get_xaxis_transform()
    axes.fill_between(run.t, 0, 1, where=coasting, transform=shade, color="0.9", lw=0)
third.axhline(0.02, color="black", linewidth=0.8, linestyle="--")
second.set(ylabel="error / magnet flux", ylim=(1e-5, 1e3))
second.legend(ncols=2)
third.set(xlabel="t (s), coasting shaded", ylabel="certificate", ylim=(1e-6, 3))
headline = "Largest error of the guarded estimate", 100 * errors["least squares"], "%"
