"""Filtered and smoothed.

What is known of a flux at an instant from all that came before, and from the whole log.
Currents with 10 mA of noise and voltages with 0.1 V, at 10 rad/s. The bands are the
deviations that are claimed; at the ends of the log both are the same.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
motor = aslo.plants.PMSM.bmp0701f()
observer = aslo.Lifted(motor.flux_relation(), output_deviation=10e-3, input_deviation=0.1)
t = 1e-4 * np.arange(10_000)
angle = 10.0 * t[:, None]
flux = motor.magnet_flux * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
y = np.concatenate([-np.sin(angle), np.cos(angle)], axis=1)
flux = np.asarray(flux + motor.inductance * y)
u = np.zeros_like(y)
u[:-1] = motor.resistance * 0.5 * (y[:-1] + y[1:]) + np.diff(flux, axis=0) / 1e-4
rng = np.random.default_rng(0)
u, y = u + 0.1 * rng.standard_normal(u.shape), y + 10e-3 * rng.standard_normal(y.shape)
estimates = {
    "filtered": aslo.replay(observer, t, u, y),
    "smoothed": aslo.smooth(observer, t, u, y),
}

figure = Figure(figsize=(7.2, 3.2), layout="constrained")
axes, rms = figure.subplots(), {}
late = t > 0.3
for name, found in estimates.items():
    error = 1e3 * np.asarray(found.value[:, 0] - flux[:, 0])
    claimed = 1e3 * np.sqrt(np.asarray(found.covariance)[:, 0, 0])
    rms[name] = np.sqrt(np.mean(error[(t > 0.5) & (t < 0.9)] ** 2))
    (line,) = axes.plot(t[late], error[late], linewidth=1, label=name)
    band = {"color": line.get_color(), "alpha": 0.15, "linewidth": 0}
    axes.fill_between(t[late], -claimed[late], claimed[late], **band)
axes.set(xlabel="t (s)", ylabel="error of the flux (mWb)", ylim=(-1.5, 2.0))
axes.legend(ncols=2)
headline = "Smoothed over filtered", rms["smoothed"] / rms["filtered"], "(rms error)"
