"""What a wrong resistance costs.

The flux error of an observer whose resistance is 1, 5 or 20 % too large, over the
electrical speed of a motor that carries 1 A: each point is a log of its own, all of
them one `jax.vmap`. At low speed the voltage is mostly `R i`, so that its error counts
most where the back-EMF is least.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
R, L, m, h = 8.875, 40.03e-3, 0.2086, 2e-4  # ohm, H, Wb, s
t = h * jnp.arange(5001)


def error(factor, speed):
    """Relative to the magnet flux, after 1 s."""
    turn = jnp.stack([jnp.cos(speed * t), jnp.sin(speed * t)], axis=1)
    current = jnp.stack([-turn[:, 1], turn[:, 0]], axis=1)
    flux = m * turn + L * current
    mean = 0.5 * (current[1:] + current[:-1])
    u = jnp.concatenate([R * mean + jnp.diff(flux, axis=0) / h, jnp.zeros((1, 2))])
    relation = aslo.plants.FluxRelation(factor * R, L)
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(speed / 2))
    found = aslo.replay(observer, t, u, current).value
    return jnp.linalg.norm(found[-1] - flux[-1]) / m


factors, speeds = jnp.array([1.0, 1.01, 1.05, 1.2]), jnp.geomspace(5.0, 600.0, 13)
errors = jax.jit(jax.vmap(jax.vmap(error, (None, 0)), (0, None)))(factors, speeds)

figure = Figure(figsize=(7.2, 3.2), layout="constrained")
axes = figure.subplots()
for factor, row in zip(factors, np.asarray(errors), strict=True):
    axes.loglog(speeds, row, ".-", label=f"{factor - 1:.0%}")
axes.set(xlabel="electrical speed (rad/s)", ylabel="flux error / magnet flux")
axes.legend(title="resistance off by", ncols=4)
at_forty = float(jnp.interp(40.0, speeds, errors[2]))
headline = "Flux error at 40 rad/s with 5 % of R", 100 * at_forty, "%"
