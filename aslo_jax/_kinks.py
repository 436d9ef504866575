"""Where a signal has a kink: comparisons that an integrator should know of."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["kinked"]

NAME = "aslo_jax_kinked"  # of a `jax.jit`, by which an integrator finds it


def kinked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of arrays, with its comparisons declared as kinks: of what it
    compares, clips, or takes the larger, the absolute value or the sign, the difference is
    a switching function.

    In continuous time by `engine="fused"`, [`simulate`][] holds their sides over a step and
    ends it where one changes, so that the vector field need be smooth between kinks only.
    Everywhere else it is the function itself: the step control of diffrax finds kinks by
    its own means.

    - `function(*arrays) -> arrays`: elementwise; of kinks within loops and conditions
      (`jax.lax.scan`, `jax.lax.cond`) nothing is known.

    A sliding mode, along which two sides push against each other (dry friction at rest), is
    no solution between kinks: a run goes through it by many short steps, with an error of
    many times the tolerance. Give such a function a narrow slope instead of a jump.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section
    II.6, discontinuous equations.
    """

    @functools.wraps(function)
    def declared(*arrays: Any) -> Any:
        return function(*arrays)

    declared.__name__ = NAME
    return functools.wraps(function)(jax.jit(declared))


@kinked
def clip(x: Any, lower: Any, upper: Any) -> Any:
    """x within limits, in its units, with a kink at each."""
    return jnp.clip(x, lower, upper)


@kinked
def larger(x: Any, y: Any) -> Any:
    """The larger of two, in their units, with a kink where they are equal."""
    return jnp.maximum(x, y)


@kinked
def smaller(x: Any, y: Any) -> Any:
    """The smaller of two, in their units, with a kink where they are equal."""
    return jnp.minimum(x, y)


@kinked
def below(x: Any, y: Any) -> Any:
    """Whether x is below y."""
    return x < y
