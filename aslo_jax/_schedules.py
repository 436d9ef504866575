"""Schedules: rates of a [`LowPass`][] that vary, ready-made."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._checks import function, is_concrete, positive, real
from ._filters import AbstractLaw, LowPass
from ._realise import Pass
from ._small import safe_reciprocal
from ._typing import PyTree, RealArray
from ._varying import AbstractSchedule, Paced, Schedule, check_limits, elapsed
from .observers._pll import _Loop, _Track

__all__ = [
    "AbstractSchedule",
    "Certified",
    "FastStart",
    "Paced",
    "PerSpeed",
    "Schedule",
    "Table",
]


class _Follow(AbstractLaw):
    """The phase-locked loop, of an angle that comes with what it is worth."""

    bandwidth: Float[Array, ""]

    def _loop(self, trust: Any) -> _Loop:
        return _Loop(self.bandwidth, trust, True)

    def flow(self, X: PyTree, v: PyTree) -> Any:
        angle, trust = v
        return self._loop(trust).flow(X, angle)

    def discretise(self, h: Any) -> Any:
        return self._loop(1.0).discretise(h)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        (before, _), (angle, trust) = v0, v1
        return self._loop(trust).advance(X, before, angle, coefficients)


def _direction(u: PyTree, y: PyTree, value: Array) -> Array:
    del u, y
    return value


class PerSpeed(AbstractSchedule):
    """`per_speed` times the speed at which the estimate turns, by a phase-locked loop on
    the estimate itself: of a flux, the electrical speed.

    - `per_speed`: the rate over the speed (1), about one;
    - `low`, `high`: the limits of the rate (rad/s); `low` at standstill;
    - `bandwidth` of the loop (rad/s);
    - `enough`: the certificate (1) below which the rate is less, in proportion: what an
      uncertain estimate turns by is no speed, and forgetting would leave it uncertain;
    - `vector(u, y, value)`: the vector of two entries that turns, by default the estimate;
      of a motor `value - L y` is the magnet's flux, without the armature's.

    The loop holds its speed while the estimate coasts. Of an [`AlgebraicObserver`][] the
    rate of the `forgetting` matters most.

    Source: theory, section 12.

    **Raises:** `ValueError` for parameters that are not positive, and for an estimate that
    has not two entries.
    """

    per_speed: Float[Array, ""] = eqx.field(converter=real, default=1.0)
    low: Float[Array, ""] = eqx.field(converter=real, default=2.0)
    high: Float[Array, ""] = eqx.field(converter=real, default=300.0)
    bandwidth: Float[Array, ""] = eqx.field(converter=real, default=60.0)
    enough: Float[Array, ""] = eqx.field(converter=real, default=0.1)
    vector: Callable[[PyTree, PyTree, Array], Array] = _direction

    def __check_init__(self) -> None:
        check_limits(self)
        positive("per_speed", self.per_speed)
        positive("bandwidth", self.bandwidth, "rad/s")
        positive("enough", self.enough)
        function("vector", self.vector)

    @property
    def limits(self) -> tuple[RealArray, RealArray]:
        return self.low, self.high

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Paced:
        zero = jnp.zeros_like(self.bandwidth)
        start = _Track(zero, zero, zero - 1.0)
        X, close = F.loop(_Follow(self.bandwidth), start, "loop")
        law = LowPass(self.bandwidth)
        seen, keep = F.loop(law, zero, "certificate")

        def closed(estimate):
            turning = self.vector(u, y, estimate.value)
            if jnp.shape(turning) != (2,):
                raise ValueError(
                    "Argument `vector` must give the two entries of what turns, but got "
                    f"the shape {jnp.shape(turning)}."
                )
            trust = jnp.where(estimate.coasting | F.missing, zero, zero + 1.0)
            close((jnp.arctan2(turning[1], turning[0]), trust))
            keep(law.inject(estimate.certificate))

        share = jnp.clip(seen / self.enough, 0.0, 1.0)
        return Paced(self.per_speed * share * jnp.abs(X.speed), closed)


class Certified(AbstractSchedule):
    """`low` where the certificate is zero, `high` where it is `enough` or more, linear
    between them: a longer memory where the state is hard to see.

    - `low`, `high`: the limits of the rate (rad/s); `enough`, of the certificate (1);
    - `bandwidth` of the low-pass filter of the certificate (rad/s).

    Source: theory, section 12.

    **Raises:** `ValueError` for parameters that are not positive.
    """

    low: Float[Array, ""] = eqx.field(converter=real)
    high: Float[Array, ""] = eqx.field(converter=real)
    enough: Float[Array, ""] = eqx.field(converter=real, default=0.1)
    bandwidth: Float[Array, ""] = eqx.field(converter=real, default=20.0)

    def __check_init__(self) -> None:
        check_limits(self)
        positive("enough", self.enough)
        positive("bandwidth", self.bandwidth, "rad/s")

    @property
    def limits(self) -> tuple[RealArray, RealArray]:
        return self.low, self.high

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Paced:
        law = LowPass(self.bandwidth)
        seen, close = F.loop(law, jnp.zeros_like(self.low), "certificate")
        share = jnp.clip(seen / self.enough, 0.0, 1.0)
        rate = self.low + (self.high - self.low) * share
        return Paced(rate, lambda estimate: close(law.inject(estimate.certificate)))


class FastStart(AbstractSchedule):
    """`gain / t`, from `high` on down to `low`: at first the mean of all that came so far,
    for `gain = 1`, and from `gain / low` on a filter of that rate.

    - `low`: the rate in the end, `high`: that of the start (rad/s); `gain` (1).

    Source: theory, section 12.

    **Raises:** `ValueError` for parameters that are not positive.
    """

    low: Float[Array, ""] = eqx.field(converter=real)
    high: Float[Array, ""] = eqx.field(converter=real, default=1e3)
    gain: Float[Array, ""] = eqx.field(converter=real, default=1.0)

    def __check_init__(self) -> None:
        check_limits(self)
        positive("gain", self.gain)

    @property
    def limits(self) -> tuple[RealArray, RealArray]:
        return self.low, self.high

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Paced:
        return Paced(self.gain / (elapsed(F, self.low) + self.gain / self.high))


class Table(AbstractSchedule):
    """The rate of a table over a measured signal, linear between its points and constant
    beyond them.

    - `signal(u, y)`: a number; `points`: its values, increasing, shape `(k,)`, in its unit;
    - `rates`: the rates there (rad/s), shape `(k,)`.

    Source: theory, section 12.

    **Raises:** `ValueError` for fewer than two points, points that do not increase, or as
    many rates as there are not points.
    """

    signal: Callable[[PyTree, PyTree], RealArray]
    points: Float[Array, " k"] = eqx.field(converter=real)
    rates: Float[Array, " k"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        function("signal", self.signal)
        positive("rates", self.rates, "rad/s")
        shapes = jnp.shape(self.points), jnp.shape(self.rates)
        if shapes[0] != shapes[1] or shapes[0][0] < 2:
            raise ValueError(
                "Arguments `points` and `rates` must have one shape (k,), k at least 2, "
                f"but got {shapes[0]} and {shapes[1]}."
            )
        if is_concrete(self.points) and not (np.diff(self.points) > 0).all():
            raise ValueError(
                "Argument `points` must increase from each to the next, but got "
                f"{self.points.tolist()}."
            )

    @property
    def limits(self) -> tuple[RealArray, RealArray]:
        return jnp.min(self.rates), jnp.max(self.rates)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Paced:
        x, gaps = self.signal(u, y), jnp.diff(self.points)
        # A sum of ramps, which needs no search.
        ramps = jnp.clip((x - self.points[:-1]) * safe_reciprocal(gaps), 0.0, 1.0)
        return Paced(self.rates[0] + jnp.sum(ramps * jnp.diff(self.rates)))
