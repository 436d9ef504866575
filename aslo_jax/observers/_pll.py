"""A phase-locked loop: speed from a measured or estimated angle."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import positive, real
from .._filters import AbstractLaw
from .._realise import Pass
from .._typing import PyTree
from ._base import AbstractObserver, Estimate

__all__ = ["PhaseLockedLoop", "wrap"]

OUT_OF_STEP = 1.0  # rad: an angle error beyond which the loop does not follow
YOUNG = 3.0  # time constants for which a loop has hardly forgotten its start


def wrap(angle: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The same `angle` (rad), of any shape, in [-pi, pi) (rad)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


class _Track(NamedTuple):
    """Angle (rad), speed (rad/s), and since the first trusted sample (s), before it -1."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    age: Float[Array, ""]


class _Loop(AbstractLaw):
    """Driven by an angle (rad) where `trust` is not zero.

    Sampled: the line fitted by least squares to all samples so far, until that forgets
    less than the weights `exp(-bandwidth age)` do, whose poles are both at
    `exp(-bandwidth dt)` (Morrison's expanding and fading memory).
    """

    bandwidth: Float[Array, ""]
    trust: Float[Array, ""] | float
    wraps: bool = eqx.field(static=True)
    within: bool = eqx.field(static=True, default=False)

    def error(self, y: Array, angle: Array) -> Array:
        return wrap(y - angle) if self.wraps else y - angle

    def flow(self, X: PyTree, v: PyTree) -> Any:
        b, e = self.bandwidth, self.trust * self.error(v, X.angle)
        return _Track(X.speed + 2.0 * b * e, b * b * e, self.trust * jnp.ones_like(X.age))

    def discretise(self, h: Any) -> Any:
        h = jnp.asarray(h, self.bandwidth.dtype)
        once, twice = -jnp.expm1(-self.bandwidth * h), -jnp.expm1(-2.0 * self.bandwidth * h)
        return h, twice, once * once

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        h, alpha, beta = (jnp.asarray(c, X.angle.dtype) for c in coefficients)
        begun = X.age >= 0
        n = jnp.where(begun, X.age, 0.0) / h + 1.0
        expanding = 2.0 / ((n + 1.0) * (n + 2.0))
        alpha = jnp.maximum(alpha, (2.0 * n + 1.0) * expanding)
        beta = jnp.maximum(beta, 3.0 * expanding)
        predicted = X.angle + h * X.speed
        e = self.trust * self.error(v1, predicted)
        # A short line is thrown far by a jump of the angle: it begins again there.
        jumped = (jnp.abs(e) > OUT_OF_STEP) & (n > 1.5) & (X.age * self.bandwidth < YOUNG)
        fresh = jnp.asarray(self.trust > 0) & (~begun | jumped)
        angle = jnp.where(begun, predicted + alpha * e, X.angle)
        speed = jnp.where(begun, X.speed + beta * e / h, X.speed)
        age = jnp.where(begun, X.age + self.trust * h, X.age)
        if self.within:
            angle, predicted = wrap(angle), wrap(predicted)
        restarted = predicted + e, jnp.zeros_like(speed), jnp.zeros_like(age)
        both = zip(restarted, (angle, speed, age), strict=True)
        return _Track(*(jnp.where(fresh, a, b) for a, b in both))


class PhaseLockedLoop(AbstractObserver):
    """`a' = w + 2 b e`, `w' = b^2 e`, `e = wrap(y - a)`, both poles at `-bandwidth`.

    - `bandwidth` b, in rad/s;
    - `wraps`: whether `y`, an angle (rad), may be wrapped; one that is not, and turns by
      less than pi between samples, needs no wrapping of the error, which a fast change of
      speed could take for a turn less;
    - `within`: whether the angle is kept in one turn, from -pi to pi, give or take an
      error, as a loop that never ends must in single precision; sampled only, and for a
      `y` that `wraps`.

    The estimate is `(a, w)`, the unwrapped angle (rad) and the speed (rad/s). Under
    constant acceleration al the speed lags by `2 al / b`.

    Sampled, it starts from the slope of the angle: with gains that fit a line to all
    samples so far, until those of the bandwidth are larger. So it is in step from the
    second sample on at any speed below pi per interval, and stable at any bandwidth. In
    continuous time it starts at rest, and pulls in at a speed far above `bandwidth` late or
    never.

    It is `coasting` until it has followed for `1 / b`, and where the angle is more than 1
    rad from a: angle and loop do not agree then.

    Source: theory, section 7; Morrison, Introduction to Sequential Smoothing and
    Prediction, 1969, chapters 9 and 13.
    """

    bandwidth: Float[Array, ""] = eqx.field(converter=real)
    wraps: bool = eqx.field(static=True, default=True)
    within: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.within and not self.wraps:
            raise ValueError(
                "Argument `within` must be False where `wraps` is: an angle that is not "
                "wrapped leaves the turn that the loop is kept in."
            )
        positive("bandwidth", self.bandwidth, "rad/s")

    def equations(self, F: Pass, u: PyTree, y: Float[Array, ""]) -> Estimate:
        del u
        dtype = jnp.result_type(y, self.bandwidth)
        y = jnp.asarray(y, dtype)
        law = _Loop(self.bandwidth, F.trust, self.wraps, self.within)
        trusted = F.trust * jnp.ones_like(y)
        X = F.evolve(law, y, _Track(y, 0.0 * y, trusted - 1.0), "track")
        young = X.age * self.bandwidth < 1.0
        away = jnp.abs(law.error(y, X.angle)) > OUT_OF_STEP
        return Estimate(jnp.stack([X.angle, X.speed]), jnp.ones_like(y), young | away)


def lagless(bandwidth: float, dt: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """What times the angle error y - a, added to the speed, removes its lag under constant
    acceleration (1/s): `2 bandwidth`, but for intervals `dt` (s)."""
    q = np.exp(-bandwidth * dt)
    return (1.0 - q) * (1.0 + 3.0 * q) / (2.0 * q * q * dt)
