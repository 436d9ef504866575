"""A phase-locked loop: speed from a measured or estimated angle."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import PyTree
from ..realise import Pass
from .base import AbstractObserver, Estimate

__all__ = ["PhaseLockedLoop", "wrap"]


def wrap(angle: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The same angle in [-pi, pi) (rad)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


class PhaseLockedLoop(AbstractObserver):
    """`a' = w + 2 b e`, `w' = b^2 e`, `e = wrap(y - a)`, both poles at `-bandwidth`.

    `y` is an angle (rad), wrapped or not; the estimate is `(a, w)`, the unwrapped angle
    (rad) and the speed (rad/s). `bandwidth` b is in rad/s. Under constant acceleration al
    the speed lags by `2 al / b`.

    Source: theory, section 7.
    """

    bandwidth: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        positive("bandwidth", self.bandwidth, "rad/s")

    def equations(self, F: Pass, u: PyTree, y: Float[Array, ""]) -> Estimate:
        del u
        b = self.bandwidth

        def rate(x):
            e = wrap(y - x[0])
            return jnp.stack([x[1] + 2.0 * b * e, b * b * e])

        x = F.state(
            "angle_speed", jnp.stack([y, 0.0 * y]).astype(jnp.result_type(y, b)), rate
        )
        return Estimate(x, jnp.ones_like(x[0]), jnp.asarray(False))
