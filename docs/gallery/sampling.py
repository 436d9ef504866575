"""How fast to sample.

A motor at constant speed, without noise, and a log of its currents. Where the voltage is
the mean over the interval, what is left is that the resistive drop is taken for a straight
line between two samples: an error that grows with the square of the angle that the flux
turns in an interval. A voltage that is read at an instant, and taken for that mean, costs
an order.
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
R, L, m, speed = 1.3, 4e-3, 0.09, 400.0  # ohm, H, Wb, rad/s
relation = aslo.plants.PMSM(R, L, m, 3, 1e-3).flux_relation()
turn = lambda t: np.stack([np.cos(speed * t), np.sin(speed * t)], axis=1)
current = lambda t: 3.0 * turn(t + 1.9 / speed)
flux = lambda t: m * turn(t) + L * current(t)
quarter = 0.5 * np.pi / speed  # the derivative of a turn is one a quarter later


def error(turned, voltage):
    """Largest error over the magnet flux, for a flux that turns by `turned` a sample."""
    h = turned / speed
    t = h * np.arange(4001)
    if voltage == "mean":
        drop = current(t) + 4.0 * current(t + 0.5 * h) + current(t + h)
        u = R * drop / 6.0 + (flux(t + h) - flux(t)) / h
    else:
        u = R * current(t) + speed * flux(t + quarter)
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(0.6 * speed))
    found = aslo.replay(observer, t, u, current(t)).value
    return np.linalg.norm(found - flux(t), axis=1)[-500:].max() / m


angles = np.geomspace(0.01, 1.0, 9)
names = {"mean": "mean over the interval", "instant": "at its first instant"}
errors = {kind: np.array([error(angle, kind) for angle in angles]) for kind in names}

figure = Figure(figsize=(7.2, 3.0), layout="constrained")
axes = figure.subplots()
for kind, values in errors.items():
    axes.loglog(angles, values, ".-", label=f"voltage: {names[kind]}")
axes.loglog(angles, 0.015 * angles**2, "k:", label="square")
axes.set(xlabel="angle per sample (rad)", ylabel="flux error / magnet flux")
axes.legend()
slope = np.polyfit(np.log(angles[:5]), np.log(errors["mean"][:5]), 1)[0]
headline = "Order of the error in the interval", slope, ""
