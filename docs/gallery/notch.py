"""A filter that does not see a vibration.

The velocity of a double integrator whose position carries a vibration of 9 rad/s. What
a filter of the observer does to it is known from the transfer function: one with zeros
at 9 rad/s leaves nothing of it, whatever its amplitude and phase.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.filters import sinusoid_rejecting

jax.config.update("jax_enable_x64", True)
h = 1e-3
t = h * jnp.arange(8_000)
u = jnp.sin(t)
speed, position = 0.5 + 1.0 - jnp.cos(t), 1.5 * t - jnp.sin(t)
y = position + 0.02 * jnp.sin(9.0 * t + 0.3)
mean = jnp.concatenate([jnp.diff(speed) / h, jnp.zeros(1)])
plant = aslo.plants.IntegratorChain(2)
filters = {
    "low-pass, 5 rad/s": aslo.LowPass(5.0),
    "zeros at 9 rad/s": sinusoid_rejecting(5.0, 9.0),
}

figure = Figure(figsize=(7.2, 3.0), layout="constrained")
axes, late = figure.subplots(), {}
for name, F in filters.items():
    observer = aslo.AlgebraicObserver(
        plant.relation(), F, aslo.Repeat(), guard=aslo.Guard(1e-6)
    )
    error = aslo.replay(observer, t, mean, y).value[:, 0] - speed
    late[name] = jnp.abs(error[t > 4.0]).max()
    axes.plot(t[100:], error[100:], label=name, linewidth=1)
axes.set(xlabel="t (s)", ylabel="error of the velocity (m/s)", ylim=(-0.3, 0.3))
axes.legend(ncols=2)
assert late["zeros at 9 rad/s"] < 1e-3 * late["low-pass, 5 rad/s"]
headline = "Error that the low-pass leaves", 1e3 * late["low-pass, 5 rad/s"], "mm/s"
