"""Five flux observers on the paper's motor.

The motor follows `2 + 0.5 sin t` rad/s under some 3 N m; no observer is told the flux
at the start. All have the gains of the paper, 5 rad/s. Printed starts have a transient,
and the division of the printed ASLO has spikes; the exact start has neither.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback

jax.config.update("jax_enable_x64", True)
motor = aslo.plants.PMSM.bmp0701f(load=lambda t: 3.0 + 0.5 * jnp.sin(0.1 * t))
flux, F = motor.flux_relation(), aslo.LowPass(5.0)
printed = aslo.AlgebraicObserver(flux, F, aslo.Repeat(), start="paper")
observers = {
    "ASLO, printed": printed,
    "A-ASLO, printed": aslo.Asymptotic(printed, 5.0, initial=[0.0, 0.0]),
    "FO1": aslo.FO1(flux, F, 5.0, start="paper"),
    "FO2": aslo.FO2(flux, 1000.0),
    "FO3": aslo.FO3(flux, F, 5.0, start="paper"),
    "ASLO, exact": aslo.AlgebraicObserver(flux, F),
}
loop = aslo.Experiment(
    motor,
    FieldOriented(
        motor, lambda t: 2.0 + 0.5 * jnp.sin(t), current_limit=2.4, voltage_limit=150.0
    ),
    observers,
    interval=1e-4,
    feedback=lambda y, x, e: MotorFeedback(y, 5 * x.angle, x.speed),
    plant_steps=2,
)
record = loop.run(steps=20_000, every=20)

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
axes = figure.subplots()
for k, name in enumerate(observers):
    error = jnp.linalg.norm(record.estimates[name].value - record.hidden, axis=1)
    style = {"color": "black", "linewidth": 2} if "exact" in name else {"color": f"C{k}"}
    axes.semilogy(record.t[1:], error[1:] / motor.magnet_flux, label=name, **style)
axes.set(xlabel="t (s)", ylabel="flux error / magnet flux", ylim=(1e-6, 1e5))
axes.legend(ncols=3)
headline = (
    "Error of the exact start",
    1e6 * np.max(error[50:]) / motor.magnet_flux,
    "ppm at most",
)
