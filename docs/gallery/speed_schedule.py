"""A filter as fast as the motor.

A motor runs up from 5 to 450 rad/s. A slow filter has little noise, where the motor is
slow; a fast one where it is fast. A rate that follows the speed of the estimate itself
has both, and every identity stays exact (theory, section 12).
"""

import jax
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.schedules import PerSpeed

jax.config.update("jax_enable_x64", True)
R, L, m, h = 1.3, 4e-3, 0.09, 1e-4  # ohm, H, Wb, s
t = h * np.arange(15_001)
speed = 5.0 * np.exp(3.0 * t)  # electrical rad/s
angle = (speed - 5.0) / 3.0
turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
y = 3.0 * np.stack([-turn[:, 1], turn[:, 0]], axis=1) + 1.0 * turn
flux = m * turn + L * y
u = np.zeros_like(flux)
u[:-1] = R * (y[1:] + y[:-1]) / 2 + np.diff(flux, axis=0) / h
rng = np.random.default_rng(0)
noises = rng.standard_normal((2, 16, *u.shape))
relation = aslo.plants.FluxRelation(R, L)
magnet = lambda u, y, value: value - L * y
rates = {
    "5 rad/s": 5.0,
    "200 rad/s": 200.0,
    "per speed": PerSpeed(per_speed=1.0, low=2.0, high=300.0, vector=magnet),
}

figure = Figure(figsize=(7.2, 3.2), layout="constrained")
axes, whole = figure.subplots(), {}
for name, rate in rates.items():
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(rate))
    replayed = jax.jit(
        jax.vmap(lambda du, dy, o=observer: aslo.replay(o, t, u + du, y + dy).value)
    )
    error = np.asarray(replayed(0.2 * noises[0], 0.02 * noises[1])) - flux
    square = np.mean(np.sum(error**2, axis=2), axis=0)
    smooth = np.sqrt(np.convolve(square, np.ones(501) / 501, "same"))
    axes.loglog(speed[1500:-300], 1e3 * smooth[1500:-300], label=name)
    whole[name] = np.sqrt(np.mean(square[1500:]))
axes.set(xlabel="electrical speed (rad/s)", ylabel="flux error (mWb, rms of 16)")
axes.legend(ncols=3)
best = min(whole["5 rad/s"], whole["200 rad/s"])
headline = "Error over that of the better constant rate", whole["per speed"] / best, ""
