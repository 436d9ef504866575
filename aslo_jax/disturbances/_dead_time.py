"""The dead time of an inverter."""

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import nonnegative, positive, real
from .._kinks import clip
from .._typing import PyTree, RealArray
from ._base import AbstractMemoryless, DisturbanceState

__all__ = ["SQRT3", "DeadTime", "first_two"]

SQRT3 = math.sqrt(3.0)


def first_two(output: PyTree) -> Float[Array, " 2"]:
    """The first two outputs of a plant: of the motors, the stator currents (A)."""
    return output[:2]


class DeadTime(AbstractMemoryless):
    """What an inverter's dead time takes from the voltage: in each of three phases the mean
    error over a switching period is `-voltage sign(i)`, i the current out of that phase.

    For the actuator of a motor, whose command is a voltage (V) of shape `(2,)` in the
    stationary amplitude-invariant frame.

    - `voltage` (V): the DC link's, times dead time over switching period; drops of the
      switches add to it;
    - `threshold` (A): below it a current changes its sign within a period, and the error is
      taken to be in proportion to it, `-voltage i / threshold`;
    - `current(output)`: the stator current (A), shape `(2,)`, among the plant's outputs; by
      default the first two.

    Source: Jeong and Park 1991, doi:10.1109/41.103442.

    **Raises:** `ValueError` where the plant's output is not at hand, which has the current.
    """

    voltage: Float[Array, ""] = eqx.field(converter=real)
    threshold: Float[Array, ""] = eqx.field(converter=real)
    current: Callable[[PyTree], Float[Array, " 2"]] = first_two

    def __check_init__(self) -> None:
        nonnegative("voltage", self.voltage)
        positive("threshold", self.threshold, "A")

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        del t, state
        if output is None:
            raise ValueError(
                "Argument `output` must be the plant's output, since the dead time depends "
                "on the current, but got None."
            )
        alpha, beta = self.current(output)
        across = 0.5 * SQRT3 * beta
        phases = jnp.stack([alpha, across - 0.5 * alpha, -across - 0.5 * alpha])
        a, b, c = clip(phases / self.threshold, -1.0, 1.0)
        # Clarke's transformation; what the three have in common drives no current.
        error = jnp.stack([(2.0 * a - b - c) / 3.0, (b - c) / SQRT3])
        return signal - self.voltage * error
