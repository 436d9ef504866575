"""A motor with saliency.

An interior PMSM whose d current ripples by 1 A. The relation without the d current,
which is not measured, has an error that follows the ripple; the relation that takes it
from the observer's own estimate has none, and needs the magnet flux for it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
R, Ld, Lq, m, h = 8.875, 20e-3, 40e-3, 0.2086, 1e-4  # ohm, H, H, Wb, s
motor = aslo.plants.InteriorPMSM(R, Ld, Lq, m, 5, 60e-6)
t = h * np.arange(15_000)
angle = 150.0 * t
d_axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
q_axis = np.stack([-d_axis[:, 1], d_axis[:, 0]], axis=1)
d, q = (-0.5 + 1.0 * np.sin(9.0 * t))[:, None], (1.0 + 0.3 * np.sin(3.0 * t))[:, None]
y = d * d_axis + q * q_axis
flux = (m + Ld * d) * d_axis + Lq * q * q_axis
u = np.zeros_like(y)
u[:-1] = R * 0.5 * (y[1:] + y[:-1]) + np.diff(flux, axis=0) / h

salient, F = motor.flux_relation(), aslo.LowPass(50.0)
both = aslo.plants.SelfConsistentFluxRelation(salient, m)
observers = {
    "without the d current": aslo.AlgebraicObserver(salient, F),
    "self-consistent": aslo.SelfConsistent(both, F, 20.0, jnp.array([0.1, 0.1])),
}

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(t, d, color="black")
above.set(ylabel="d current (A)")
late, rms = t > 1.0, {}
for name, observer in observers.items():
    found = np.asarray(aslo.replay(observer, t, u, y, substeps=2).value)
    error = np.linalg.norm(found - flux, axis=1)
    rms[name] = np.sqrt(np.mean(error[late] ** 2))
    below.semilogy(t[1:], error[1:] / m, label=name)
below.set(xlabel="t (s)", ylabel="flux error / magnet flux", ylim=(1e-6, 3))
below.legend(ncols=2)
headline = "Error without the d current", 1e3 * rms["without the d current"], "mWb (rms)"
