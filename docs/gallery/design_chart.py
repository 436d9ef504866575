"""Where to put the two rates of an A-ASLO.

The double integrator with white noise on its input (intensity 1) and its measurement
(0.01). The variance of the velocity over both rates is known in closed form (theory,
section 4); least at `lam = gamma = (5W/(3V))^(1/4)`, 4 % above the Kalman filter. The
dots are simulated, with 512 noises each.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
W, V, h = 1.0, 0.01, 0.01


def variance(lam, gamma):
    """`P` of theory, section 4."""
    s, p = gamma + lam, gamma * lam
    return V * p**2 / (2 * s) + W / (2 * s) + W * s / (2 * p)


def simulated(lam, gamma, key, steps=1000):
    plant = aslo.plants.IntegratorChain(2)
    inner = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(lam), aslo.Repeat(), None)
    observer = aslo.Asymptotic(inner, gamma)
    first, second = jax.random.split(key)
    force = jnp.sqrt(W / h) * jax.random.normal(first, (steps,))
    speed = jnp.concatenate([jnp.zeros(1), jnp.cumsum(h * force)[:-1]])
    position = jnp.concatenate(
        [jnp.zeros(1), jnp.cumsum(h * speed + h**2 / 2 * force)[:-1]]
    )
    y = position + jnp.sqrt(V / h) * jax.random.normal(second, (steps,))
    found = aslo.replay(observer, h * jnp.arange(steps), jnp.zeros(steps), y).value
    return (found[-1, 0] - speed[-1]) ** 2


best = (5 * W / (3 * V)) ** 0.25
keys = jax.random.split(jax.random.key(0), 512)
pairs = [(best, best), (1.5, 8.0), (8.0, 1.5), (1.5, 1.5), (8.0, 8.0)]
run = jax.jit(jax.vmap(simulated, (None, None, 0)))
measured = np.array([np.mean(run(lam, gamma, keys)) for lam, gamma in pairs])

rates = np.geomspace(0.8, 16.0, 80)
chart = variance(rates[None, :], rates[:, None])
figure = Figure(figsize=(4.6, 3.8), layout="constrained")
axes = figure.subplots()
kalman = np.sqrt(2) * W**0.75 * V**0.25
levels = [1.04, 1.1, 1.2, 1.4, 1.7, 2, 2.5, 3]
lines = axes.contour(rates, rates, chart / kalman, levels, cmap="viridis")
axes.clabel(lines, fmt="%g")
for (lam, gamma), value in zip(pairs, measured, strict=True):
    axes.plot(lam, gamma, "k.")
    axes.annotate(f" {value / kalman:.2f}", (lam, gamma))
axes.set(xscale="log", yscale="log", xlabel="lam (rad/s)", ylabel="gamma (rad/s)")
axes.set_title("variance over the Kalman filter's")
ratio = np.mean(measured / np.array([variance(*pair) for pair in pairs]))
headline = "Simulated over closed form", ratio, "(mean of five pairs)"
