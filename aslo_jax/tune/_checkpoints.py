"""A batch with reverse derivatives, in memory for the square root of its steps."""

import math

import jax
import jax.numpy as jnp

from .._typing import PyTree
from ..engines._fused.plan import Plan


def checkpointed(plan: Plan, samples: PyTree, steps: int) -> PyTree:
    """The metrics of a plan after `steps`, for samples with a leading axis.

    Blocks of about the square root of the steps keep their first state only, and run again
    for the derivative: one more run, and memory for two square roots of the steps instead
    of all of them.
    """
    size = math.isqrt(steps)

    def one(sample):
        state, _, prepared = plan.begun(sample)

        def step(state, k):
            return plan.step(k, state, sample, prepared)[0], None

        @jax.checkpoint
        def block(state, k):
            return jax.lax.scan(step, state, k + jnp.arange(size))[0], None

        whole = steps // size
        state, _ = jax.lax.scan(block, state, size * jnp.arange(whole))
        state, _ = jax.lax.scan(step, state, jnp.arange(size * whole, steps))
        return plan.results(state)

    return jax.vmap(one)(samples)
