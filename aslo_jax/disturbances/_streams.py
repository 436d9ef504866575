"""Random numbers of several disturbances, kept apart."""

from itertools import combinations
from typing import Any

import jax
import numpy as np

from .. import random
from .._checks import is_concrete, kind
from .._typing import PyTree
from ._base import AbstractDisturbance

__all__ = ["check_streams"]


def check_disturbances(actuator: Any, sensor: Any, input_sensor: Any) -> None:
    """Refuse what is no disturbance in its place, nor `None`.

    **Raises:** `ValueError`."""
    kind("actuator", actuator, AbstractDisturbance, hint="a disturbance")
    kind("sensor", sensor, AbstractDisturbance, hint="a disturbance")
    kind("input_sensor", input_sensor, AbstractDisturbance, hint="a disturbance")


def check_streams(tree: PyTree) -> None:
    """Refuse two random disturbances, anywhere in `tree`, that draw the same numbers: they
    have the same `key` and the same `stream`. Keys that are traced are the same if they are
    one value.

    **Raises:** `ValueError`.
    """
    drawing = lambda x: isinstance(x, AbstractDisturbance) and hasattr(x, "stream")
    found = filter(drawing, jax.tree.leaves(tree, is_leaf=drawing))
    for a, b in combinations(found, 2):
        if a.stream == b.stream and _same(a.key, b.key):
            raise ValueError(
                f"Arguments `stream` of {type(a).__name__} and {type(b).__name__} must "
                f"differ where they share a key, but both are {a.stream}: they would draw "
                "the same numbers."
            )


def _same(a: random.Key, b: random.Key) -> bool:
    if a is b:
        return True
    return is_concrete(a, b) and np.array_equal(np.asarray(a), np.asarray(b))
