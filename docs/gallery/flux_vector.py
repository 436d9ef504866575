"""The flux vector as it is found.

The first 60 ms of the recorded motor, slowed down: the true flux (grey), the estimate
with the exact start (blue), which is there within a millisecond, and with the printed
one (red).
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
found = {}
for start in ("paper", "exact"):
    observer = aslo.AlgebraicObserver(
        motor.flux_relation(), aslo.LowPass(20.0), start=start
    )
    found[start] = np.asarray(aslo.replay(observer, log.t, log.u, log.y, substeps=4).value)

figure = Figure(figsize=(3.6, 3.6), layout="constrained")
axes = figure.subplots()
axes.set(xlabel="alpha (Wb)", ylabel="beta (Wb)", xlim=(-0.42, 0.42), ylim=(-0.42, 0.42))
axes.set_aspect("equal")
lines = {}
for name, values, color, width in (
    ("true", flux, "0.75", 5),
    ("paper", found["paper"], "#D55E00", 1.5),
    ("exact", found["exact"], "#0072B2", 1.5),
):
    (trail,) = axes.plot([], [], color=color, linewidth=width)
    (tip,) = axes.plot([], [], "o", color=color, markersize=width + 3)
    lines[name] = values, trail, tip
clock = axes.text(-0.39, 0.36, "")
frames, rows = 60, 5  # one frame a millisecond


def draw(frame):
    last = 1 + rows * frame
    for values, trail, tip in lines.values():
        some = values[max(last - 60, 1) : last + 1]
        trail.set_data(some[:, 0], some[:, 1])
        tip.set_data(some[-1:, 0], some[-1:, 1])
    clock.set_text(f"{1e3 * log.t[last]:.0f} ms")


error = np.linalg.norm(found["exact"] - flux, axis=1) / motor.magnet_flux
settled = np.flatnonzero(error > 0.01)[-1] + 1
headline = "Within 1 % of the magnet flux after", 1e3 * log.t[settled], "ms"
