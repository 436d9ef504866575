"""A log with holes.

A tenth of the samples of the recorded motor is gone, most of them in two long holes.
Over what is missing the estimate is carried on and flagged, until the filter has
forgotten the hole; nothing is filled in by hand.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.logs import read_log

jax.config.update("jax_enable_x64", True)
log = read_log("aslo_jax/data/pmsm_log.csv")
rows = slice(0, 2500)
t, u, y = log.t[rows], log.u[rows].copy(), log.y[rows].copy()
flux = np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)[rows]
missing = np.random.default_rng(0).random(t.size) < 0.02
missing[800:900] = missing[1600:1700] = True
u[missing], y[missing] = np.nan, np.nan

motor = aslo.plants.PMSM.bmp0701f()
observer = aslo.AlgebraicObserver(
    motor.flux_relation(), aslo.LowPass(100.0), guard=aslo.Guard(1e-3)
)
found = aslo.replay(observer, t, u, y, missing="coast", substeps=4)
error = np.linalg.norm(np.asarray(found.value) - flux, axis=1) / motor.magnet_flux
coasting = np.asarray(found.coasting)

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(t, y[:, 0], linewidth=0.8)
above.set(ylabel="current (A)")
below.semilogy(t[1:], error[1:], linewidth=0.8)
below.set(xlabel="t (s), flagged shaded", ylabel="error / magnet flux", ylim=(1e-6, 10))
for axes in (above, below):
    shade = axes.get_xaxis_transform()
    axes.fill_between(t, 0, 1, where=coasting, transform=shade, color="0.88", lw=0)
trusted = ~coasting & (t > 0.02)
headline = "Largest error where it is not flagged", 100 * error[trusted].max(), "%"
