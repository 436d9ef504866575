"""A system in continuous time beside its tangent, in some of its arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._typing import PyTree
from .system import System


def beside_tangents(system: System) -> System:
    """The system with its derivative along the `rates` of its real arrays, a tree like
    them with `None` elsewhere: its arrays are `(arrays, rates)`, its state `(state, rate)`,
    its rows `(row, rate)`. So the tangent is integrated to the tolerance of the state."""

    def init(given):
        arrays, rates = given
        return _pushed(lambda arrays, _: system.init(arrays), arrays, rates, (), ())

    def rate(given, t, pair):
        (arrays, rates), (state, along) = given, pair
        field = lambda arrays, state: system.rate(arrays, t, state)
        return _pushed(field, arrays, rates, state, along)

    def record(given, t, pair):
        (arrays, rates), (state, along) = given, pair
        row = lambda arrays, state: system.record(arrays, t, state)
        return _pushed(row, arrays, rates, state, along)

    return System(init, rate, record)


def _pushed(function: Any, arrays: PyTree, rates: PyTree, state: PyTree, along: PyTree):
    """What a function of arrays and state gives, and the rate of what is real of it."""
    moving, fixed = eqx.partition(arrays, eqx.is_inexact_array)
    changing, held = eqx.partition(state, eqx.is_inexact_array)

    def of(moving, changing):
        return function(eqx.combine(moving, fixed), eqx.combine(changing, held))

    out, rate = jax.jvp(of, (moving, changing), (rates, along))
    return out, jax.tree.map(lambda r, x: r if _is_real(x) else None, rate, out)


def rates_of(leaves: list[Any], rates: list[Any]) -> list[Any]:
    """The tangents of what is real among leaves, `None` for others."""
    return [r if _is_real(x) else None for x, r in zip(leaves, rates, strict=True)]


def tangents_of(row: PyTree, outcome: PyTree, rate: PyTree) -> Any:
    """Those of rows and outcome, whose other leaves have none."""
    real = iter(jax.tree.leaves(rate))
    of = lambda x: next(real) if _is_real(x) else _nothing(x)
    still = lambda x: jnp.zeros_like(x) if _is_real(x) else _nothing(x)
    return jax.tree.map(of, row), jax.tree.map(still, outcome)


def _nothing(x: Any) -> np.ndarray:
    return np.zeros(jnp.shape(x), jax.dtypes.float0)


def _is_real(x: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(x), jnp.floating)
