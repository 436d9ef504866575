"""A loop as a user may write it, x[k+1] = step(x[k], sample), and what it gives by hand."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from aslo_jax.engines import Runner
from aslo_jax.experiment import Record


class Iteration(eqx.Module):
    """As a user may write an experiment: x[k+1] = step(x[k], sample)."""

    sample: Any
    step: Callable = eqx.field(static=True)
    begin: Callable = eqx.field(static=True)

    def init(self):
        start = self.begin(self.sample)
        return start, recorded(start)

    def prepare(self, carry):
        return None

    def advance(self, k, carry, prepared):
        after = self.step(carry, self.sample)
        return after, recorded(after)


def recorded(z):
    nothing = jnp.zeros(())
    return Record(nothing, z, jnp.zeros(1), nothing, nothing, {})


def rotated(z, gain):
    return z[0] - 1e-3 * z[1], z[1] + gain * 1e-3 * z[0]


def started(gain):
    return gain, 0.0 * gain


def runner(steps=200, engine="fused", step=rotated, begin=started, like=1.0, **settings):
    make = lambda sample: Iteration(sample, step, begin)
    settings = dict(every=steps, record=lambda r: r.x) | settings
    return Runner(make, like, steps, engine=engine, **settings)


def last(found):
    return np.asarray(found.record[0])[:, -1]


GAINS = np.linspace(-1.0, 1.0, 37)


def turned(gains, steps):
    """By powers of the matrix of a step."""
    step = np.stack(
        [
            np.stack([np.ones_like(gains), -1e-3 * np.ones_like(gains)], -1),
            np.stack([1e-3 * gains, np.ones_like(gains)], -1),
        ],
        1,
    )
    return np.linalg.matrix_power(step, steps)[:, 0, 0] * gains
