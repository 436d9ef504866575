"""Exact start against the printed one.

The flux of a recorded motor. Both observers solve the same equations at 20 rad/s; one
starts its filters as the paper prints them, the other so that the identity holds from
the first instant. The record begins in the middle of the run, so that nobody knows the
flux of its first row.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.logs import read_log

jax.config.update("jax_enable_x64", True)
log = read_log("aslo_jax/data/pmsm_log.csv")
flux = np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)
motor = aslo.plants.PMSM.bmp0701f()

figure = Figure(figsize=(7.2, 3.4), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
early = log.t <= 0.15
above.plot(log.t[early], flux[early, 0], color="0.75", linewidth=4, label="true")
errors = {}
for start, name, color in (("paper", "printed", "#D55E00"), ("exact", "exact", "#0072B2")):
    observer = aslo.AlgebraicObserver(
        motor.flux_relation(), aslo.LowPass(20.0), start=start
    )
    found = aslo.replay(observer, log.t, log.u, log.y, substeps=4).value
    errors[name] = np.linalg.norm(found - flux, axis=1) / motor.magnet_flux
    above.plot(log.t[early], found[early, 0], color=color, label=f"{name} start")
    below.semilogy(log.t[early][1:], errors[name][early][1:], color=color)
above.set(ylabel="flux (Wb)", ylim=(-0.7, 0.9))
above.legend(ncols=3)
below.set(xlabel="t (s)", ylabel="error / magnet flux")
headline = (
    "Flux error 10 ms after the start",
    100 * errors["exact"][50],
    "% of the magnet flux",
)
