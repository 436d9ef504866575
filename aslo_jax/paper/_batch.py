"""Adaptive solves that differ by a number."""

from collections.abc import Callable

import jax
import numpy as np

from .._typing import PyTree


def one_by_one(one: Callable[[PyTree], PyTree], over: PyTree) -> PyTree:
    """What `jax.vmap(one)(over)` gives, as NumPy arrays. An adaptive solve takes twice as
    long to compile for a batch."""
    run, count = jax.jit(one), len(jax.tree.leaves(over)[0])
    each = [run(jax.tree.map(lambda x, k=k: x[k], over)) for k in range(count)]
    return jax.tree.map(lambda *x: np.stack(x), *each)
