"""A resistance found while the motor runs.

The resistance that the observer is told is 15 % too small, the magnet flux 3 % too
large. The adaptive filter has both as states beside the flux, with the deviations that
are stated; the ASLO holds them. Currents and voltages have noise.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
R, L, m, h = 8.875, 40.03e-3, 0.2086, 1e-4  # ohm, H, Wb, s
t = h * np.arange(20_000)
angle = 40.0 * t + 10.0 * np.sin(2 * t)
turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
across = np.stack([-turn[:, 1], turn[:, 0]], axis=1)
y = (1.0 + 0.5 * np.sin(5.0 * t))[:, None] * across
flux = m * turn + L * y
u = np.zeros_like(y)
u[:-1] = R * 0.5 * (y[1:] + y[:-1]) + np.diff(flux, axis=0) / h
rng = np.random.default_rng(1)
u, y = u + 0.1 * rng.standard_normal(u.shape), y + 0.01 * rng.standard_normal(y.shape)

told = aslo.plants.FluxRelation(0.85 * R, L, 1.03 * m)
adaptive = aslo.Adaptive(told, 0.01, 0.1)
estimates = {
    "ASLO": aslo.replay(aslo.AlgebraicObserver(told, aslo.LowPass(20.0)), t, u, y),
    "adaptive": aslo.replay(adaptive, t, u, y),
}
found = estimates["adaptive"]

figure = Figure(figsize=(7.2, 3.8), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
for name, each in estimates.items():
    error = np.linalg.norm(np.asarray(each.value) - flux, axis=1) / m
    above.semilogy(t[1:], error[1:], label=name, linewidth=0.8)
above.set(ylabel="error / magnet flux", ylim=(1e-4, 3))
above.legend(ncols=2)
resistance = np.asarray(found.parameters)[:, 0]
below.plot(t, resistance, color="#D55E00")
below.axhline(R, color="black", linewidth=0.8, linestyle="--")
below.set(xlabel="t (s)", ylabel="resistance (ohm)", ylim=(6, 11))
headline = "Resistance after 2 s, off by", 100 * abs(resistance[-1] / R - 1), "%"
