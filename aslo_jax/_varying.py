"""A filter whose rate varies: `w' = -lam(t) w + v`, with any known `lam(t) > 0`.

Every identity of the Swapping Lemma stays exact for the law `w' = -lam w + v` as long as
nothing is multiplied by lam before it is filtered: what is injected is `s` itself, and the
filtered derivative is `G[s'] = s - g` with `g' = lam (s - g)`, so that lam' is never needed
(theory, section 12). Rows are multiplied by lam afterwards, which gives them the size that
they have with a constant rate.
"""

import abc
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._checks import function, is_concrete, positive, real
from ._laws import AbstractFilter, AbstractLaw, Remembering, held, scalar_hold
from ._module import Module
from ._typing import PyTree, RealArray

__all__ = ["AbstractSchedule", "Paced", "Schedule", "Varying"]


class Paced(NamedTuple):
    """The `rate` of a filter now (rad/s), shape `()`, and `close`, a function of the
    estimate that is called at the end of the pass; `None` where the rate does not depend
    on the estimate."""

    rate: Float[Array, ""]
    close: Callable[[Any], object] | None = None


class AbstractSchedule(Module):
    """A rate that varies, for [`LowPass`][]: equations as an observer's, so that it may
    have states of its own.

    A sampled filter holds the rate of the left end of an interval over all of it.
    """

    @property
    @abc.abstractmethod
    def limits(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The least rate and the greatest one, which it keeps (rad/s)."""

    @abc.abstractmethod
    def equations(self, F: Any, u: PyTree, y: PyTree) -> Paced:
        """The rate at an instant: a pass `F`, the input `u` and the measurement `y`."""

    def paced(self, F: Any, u: PyTree, y: PyTree) -> tuple["Varying", Any]:
        """The filter of the rate now, within the limits, and what closes its loop."""
        (rate, close), (low, high) = self.equations(F, u, y), self.limits
        return Varying(jnp.clip(rate, low, high), low), close


LOWEST, HIGHEST = 1e-3, 1e6  # rad/s, limits of a function that comes without any


class Schedule(AbstractSchedule):
    """The rate `function(t, u, y)` (rad/s), t being the time since the start (s).

    - `function`: a function, or a module, whose parameters can be tuned then;
    - `low`, `high`: the limits of the rate (rad/s).

    Source: theory, section 12.

    **Raises:** `ValueError` for limits that are not positive.
    """

    function: Callable[[Float[Array, ""], PyTree, PyTree], RealArray | float]
    low: Float[Array, ""] = eqx.field(converter=real, default=LOWEST)
    high: Float[Array, ""] = eqx.field(converter=real, default=HIGHEST)

    def __check_init__(self) -> None:
        function("function", self.function)
        check_limits(self)

    @property
    def limits(self) -> tuple[RealArray, RealArray]:
        return self.low, self.high

    def equations(self, F: Any, u: PyTree, y: PyTree) -> Paced:
        t = elapsed(F, self.low)
        return Paced(jnp.asarray(self.function(t, u, y), t.dtype))


class _Clock(AbstractLaw):
    """The time (s), and what its last digits have lost: in single precision a sum of tenths
    of a millisecond stands still after half an hour.

    Source: Kahan, 1965, doi:10.1145/363707.363723.
    """

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return v, jnp.zeros_like(v)

    def discretise(self, h: RealArray | float) -> PyTree:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        time, lost = X
        by = jnp.asarray(coefficients, time.dtype) + lost
        # Time only grows: what the maxima say is so, but no compiler may cancel over them.
        total = jnp.maximum(time + by, time)
        added = jnp.maximum(total - time, 0.0)
        return total, by - added


def elapsed(F: Any, like: RealArray) -> RealArray:
    """The time since the start (s), a state of the pass `F` with the type of `like`."""
    zero = jnp.zeros_like(like)
    time, _ = F.evolve(_Clock(), jnp.ones_like(like), (zero, zero), "time")
    return time


def check_limits(schedule: Any) -> None:
    """Refuse limits that are not positive, or the wrong way round."""
    low, high = schedule.low, schedule.high
    positive("low", low, "rad/s")
    positive("high", high, "rad/s")
    numbers = all(isinstance(x, jax.Array | float) and is_concrete(x) for x in (low, high))
    if numbers and not (np.asarray(low) <= np.asarray(high)).all():
        raise ValueError(
            "Argument `low` must be at most `high` (rad/s), but got "
            f"{np.asarray(low).tolist()} and {np.asarray(high).tolist()}."
        )


class _Driven(NamedTuple):
    """A drive, and the rate (rad/s) from its instant on."""

    value: PyTree
    rate: Float[Array, ""]


class _Decay(AbstractLaw):
    """`X' = v - rate X`, or where it is `tracking`, `X' = rate (v - X)`; the rate comes
    with the drive and is never below `low`. Sampled, it is that of the left end."""

    low: Float[Array, ""]
    tracking: bool = eqx.field(static=True)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        value, rate = v
        return rate * (value - X) if self.tracking else value - rate * X

    def discretise(self, h: RealArray | float) -> PyTree:
        h = jnp.asarray(h, self.low.dtype)
        kept = jnp.exp(-self.low * h)  # at most, over an interval
        return Remembering(h, kept, kept)

    def mapped(self, f: Callable[..., PyTree], *drives: PyTree) -> PyTree:
        return drives[0]._replace(value=f(*(each.value for each in drives)))

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        rate = v0.rate
        hold = scalar_hold(rate, jnp.asarray(coefficients.hold, rate.dtype))
        if self.tracking:
            hold = hold._replace(left=rate * hold.left, right=rate * hold.right)
        return held(hold, X, operator.mul, v0.value, v1.value)


class _AbstractVarying(AbstractFilter):
    """What both filters of a rate have in common."""

    rate: eqx.AbstractVar[Float[Array, ""]]
    low: eqx.AbstractVar[Float[Array, ""]]

    @property
    @abc.abstractmethod
    def tracking(self) -> bool:
        """Whether the rate multiplies what is injected, too."""

    @property
    def strictly_proper(self) -> bool:
        return True

    @property
    def varies(self) -> bool:
        return True

    def inject(self, s: RealArray | float) -> RealArray:
        return jnp.asarray(s, jnp.result_type(s, self.rate))

    def feedthrough(self, s: RealArray | float) -> RealArray | float:
        return 0.0

    def following(
        self, drive: PyTree, start: PyTree | None
    ) -> tuple[AbstractLaw, PyTree, PyTree]:
        law = _Decay(self.low, self.tracking)
        if callable(drive):
            return law, lambda X: _Driven(drive(X), self.rate), start
        if start is None:
            start = jnp.zeros_like(drive)
        return law, _Driven(drive, self.rate), start

    def discretise(self, h: RealArray | float) -> PyTree:
        return _Decay(self.low, self.tracking).discretise(h)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        law = _Decay(self.low, self.tracking)
        left, right = _Driven(v0, self.rate), _Driven(v1, self.rate)
        return law.advance(X, left, right, coefficients)


class Varying(_AbstractVarying):
    """`w' = -rate w + s`, with the output `rate w`: the filter of a [`LowPass`][] whose
    rate varies, at an instant. `low` is the least that it may have; both in rad/s."""

    rate: Float[Array, ""]
    low: Float[Array, ""]

    @property
    def tracking(self) -> bool:
        return False

    @property
    def derivative(self) -> AbstractFilter:
        return _Tracking(self.rate, self.low)

    def output(self, X: RealArray) -> RealArray:
        return self.rate * X

    def equilibrium(self, s: RealArray | float) -> RealArray:
        return self.inject(s) / self.rate

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return v - self.rate * X


class _Tracking(_AbstractVarying):
    """`g' = rate (s - g)`, whose derivative is the filtered derivative of s, times the rate
    as all outputs of [`Varying`][] are."""

    rate: Float[Array, ""]
    low: Float[Array, ""]

    @property
    def tracking(self) -> bool:
        return True

    def output(self, X: RealArray) -> RealArray:
        return X

    def equilibrium(self, s: RealArray | float) -> RealArray:
        return self.inject(s)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return self.rate * (v - X)
