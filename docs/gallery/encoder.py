"""A velocity behind an encoder.

The angular speed of a beam with a ball on it, from an encoder of 12 bits. A filtered
derivative lags and passes the steps of the encoder on. The algebraic observer knows
masses and torque, and filters without a lag; a high-gain observer with the same model
is quieter still at this rate.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import BallBeamTracking, MechanicalFeedback
from aslo_jax.disturbances import Encoder

jax.config.update("jax_enable_x64", True)
ball, interval = aslo.plants.BallBeam(length=1.2), 1e-3  # m, s
simple = {
    "filtered derivative": aslo.FilteredDerivative(aslo.LowPass(40.0)),
    "super-twisting": aslo.SuperTwisting([0.5, 6.0]),
    "high gain, model": aslo.HighGain(20.0, ball),
}
loop = aslo.Experiment(
    ball,
    BallBeamTracking(ball, lambda t: 0.3 * jnp.sin(1.5 * t)),
    {name: aslo.Unwrapped(each, ball.angles) for name, each in simple.items()}
    | {"ASLO": aslo.velocity_observer(ball, aslo.LowPass(10.0))},
    interval,
    feedback=lambda y, x, e: MechanicalFeedback(x.position, x.velocity),
    sensor=Encoder([1.2 / 2**12, 2 * jnp.pi / 2**12], ball.angles),
)
run = loop.run(6_000)
late, rms = (run.t > 3.0) & (run.t < 4.5), {}

figure = Figure(figsize=(7.2, 3.4), layout="constrained")
axes = figure.subplots()
for name, found in run.estimates.items():
    off = found.value[:, 1] - run.hidden[:, 1]
    rms[name] = float(jnp.sqrt(jnp.mean(off[run.t > 2.0] ** 2)))
    label = f"{name}: {rms[name]:.4f} rad/s"
    axes.plot(run.t[late], off[late], linewidth=0.7, label=label)
axes.set(xlabel="t (s)", ylabel="error of the beam's speed (rad/s)", ylim=(-0.1, 0.15))
axes.legend(ncols=2)
headline = (
    "Filtered derivative over ASLO",
    rms["filtered derivative"] / rms["ASLO"],
    "(rms error)",
)
