"""How fast to sample.

A motor at constant speed, exact mean voltages and currents without noise: what is left
is that an estimate takes the current between two samples for a straight line. Its error
grows with the square of the angle that the flux turns in an interval; four substeps
divide it by ten and more.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
R, L, m, h = 1.3, 4e-3, 0.09, 1e-4  # ohm, H, Wb, s
t = h * np.arange(4001)
relation = aslo.plants.PMSM(R, L, m, 3, 1e-3).flux_relation()


def error(turned, substeps):
    """Largest error over the magnet flux, for a flux that turns by `turned` a sample."""
    speed = turned / h
    turn = lambda t: np.stack([np.cos(speed * t), np.sin(speed * t)], axis=1)
    current = lambda t: 3.0 * turn(t + 1.9 / speed)
    flux = m * turn(t) + L * current(t)
    mean = (current(t[:-1]) + 4.0 * current(t[:-1] + 0.5 * h) + current(t[1:])) / 6.0
    u = R * mean + np.diff(flux, axis=0) / h
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(0.6 * speed))
    found = aslo.replay(observer, t[:-1], u, current(t[:-1]), substeps=substeps).value
    return np.linalg.norm(found - flux[:-1], axis=1)[-500:].max() / m


angles = np.geomspace(0.01, 1.0, 9)
errors = {n: np.array([error(angle, n) for angle in angles]) for n in (1, 4)}

figure = Figure(figsize=(7.2, 3.0), layout="constrained")
axes = figure.subplots()
for n, values in errors.items():
    axes.loglog(angles, values, ".-", label=f"{n} substep{'s' if n > 1 else ''}")
axes.loglog(angles, 0.15 * angles**2, "k:", label="square")
axes.set(xlabel="angle per sample (rad)", ylabel="flux error / magnet flux")
axes.legend(ncols=3)
slope = np.polyfit(np.log(angles[:5]), np.log(errors[1][:5]), 1)[0]
headline = "Order of the error in the interval", slope, ""
