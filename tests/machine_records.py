"""Logs of machines whose motion is given, in closed form but for white noise."""

import jax
import jax.numpy as jnp
import numpy as np
from motion import Prescribed


def record(motion, current, mean, interval, rows, noise, seed=0):
    """t, u and y of a motion, with white noise on y (of its rms)."""
    t = interval * jnp.arange(rows)
    both = jax.jit(jax.vmap(lambda t: (mean(t, t + interval), current(t))))
    u, y = (np.asarray(x) for x in both(t))
    size = noise * np.sqrt(np.mean(y**2, axis=0))
    return np.asarray(t), u, y + size * np.random.default_rng(seed).standard_normal(y.shape)


def motor_log(machine, speed, i_d, i_q, interval, rows, noise=3e-3, seed=0):
    p = machine.pole_pairs

    def angle(t):  # mechanical
        return 0.3 + (speed * t + 0.25 * speed / 9 * (1 - jnp.cos(9 * t))) / p

    def current(t):
        theta = p * angle(t)
        d, q = i_d(t), i_q(t)
        c, s = jnp.cos(theta), jnp.sin(theta)
        return jnp.stack([d * c - q * s, d * s + q * c])

    motion = Prescribed(machine, angle, current)
    return record(motion, current, motion.mean_voltage, interval, rows, noise, seed)
