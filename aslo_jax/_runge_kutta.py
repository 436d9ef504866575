"""Runge and Kutta's fourth-order step, written out, without diffrax."""

from collections.abc import Callable
from typing import Any

import jax

from ._typing import PyTree


def runge_kutta(rate: Callable[[Any, PyTree], PyTree], t: Any, x: PyTree, h: Any) -> PyTree:
    """x at t + h, from `x' = rate(t, x)`; one step, written out."""

    def plus(scale, k):
        return jax.tree.map(lambda x, k: x + scale * k, x, k)

    k1 = rate(t, x)
    k2 = rate(t + 0.5 * h, plus(0.5 * h, k1))
    k3 = rate(t + 0.5 * h, plus(0.5 * h, k2))
    k4 = rate(t + h, plus(h, k3))
    total = jax.tree.map(lambda a, b, c, d: a + 2.0 * (b + c) + d, k1, k2, k3, k4)
    return plus(h / 6.0, total)
