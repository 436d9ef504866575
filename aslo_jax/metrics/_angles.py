"""Errors of angles, in electrical degrees."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import nonnegative, real
from .._experiment import Record
from .._module import Module
from .._typing import PyTree
from ..observers import electrical_angle, wrap
from ._base import AbstractComposed, estimate_of, size
from ._functions import Maximum, Mean

__all__ = ["AngleError", "FluxAngle", "PeakAngleError", "RotorAngle", "degrees_between"]


class FluxAngle(Module):
    """The electrical angle (rad) of a motor with magnets, of a record in which `observer`
    estimates the stator flux: that of the flux less `inductance` (H; of an interior motor
    that of the q axis; zero for the magnet's flux) times the measured current, the first
    two entries of y."""

    observer: str = eqx.field(static=True)
    inductance: Float[Array, ""] = eqx.field(converter=real)

    def __call__(self, record: Record) -> Float[Array, ""]:
        flux = estimate_of(record, self.observer).value[:2]
        return electrical_angle(flux - self.inductance * record.y[:2])


class RotorAngle(Module):
    """The true electrical angle (rad) of a record: `pole_pairs` times the plant's angle."""

    pole_pairs: int = eqx.field(static=True)

    def __call__(self, record: Record) -> Float[Array, ""]:
        return self.pole_pairs * record.x.angle


class AngleError(AbstractComposed):
    """The root of the mean squared difference of two angles from `after` (s) on, in
    electrical degrees, each difference taken within half a turn. Infinite where an angle
    was not finite.

    - `estimate(record)`: the estimated electrical angle (rad), shape `()`: [`FluxAngle`][],
      or for an observer that estimates angles `lambda r: r.estimates["PLL"].value[0]`;
    - `truth(record)`: the true one (rad), [`RotorAngle`][] for a motor.
    """

    estimate: Callable[[Record], Float[Array, ""]]
    truth: Callable[[Record], Float[Array, ""]]
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def result(self, state: PyTree) -> PyTree:
        return size(jnp.sqrt(self.inner().result(state)))

    def inner(self) -> Mean:
        return Mean(
            lambda r: degrees_between(self.estimate(r), self.truth(r)) ** 2, self.after
        )


class PeakAngleError(AbstractComposed):
    """As [`AngleError`][], with its `estimate`, `truth` and `after` (s), but the largest
    difference in magnitude.
    """

    estimate: Callable[[Record], Float[Array, ""]]
    truth: Callable[[Record], Float[Array, ""]]
    after: Float[Array, ""] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        nonnegative("after", self.after)

    def result(self, state: PyTree) -> PyTree:
        return jnp.maximum(state, 0.0)

    def inner(self) -> Maximum:
        return Maximum(
            lambda r: size(degrees_between(self.estimate(r), self.truth(r))), self.after
        )


def degrees_between(a: Float[Array, ""], b: Float[Array, ""]) -> Float[Array, ""]:
    """`a - b` of two angles (rad), within half a turn, in degrees."""
    return (180.0 / jnp.pi) * wrap(a - b)
