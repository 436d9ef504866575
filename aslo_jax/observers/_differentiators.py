"""Differentiators: velocities from positions with no model, or with a full one."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._filters import AbstractFilter, AbstractLaw, LinearSystem, Switched
from .._realise import Pass
from .._signals import check_shapes
from .._typing import PyTree, RealArray
from ..plants import AbstractMechanicalSystem
from ._base import AbstractObserver, Estimate

__all__ = ["FilteredDerivative", "HighGain", "SuperTwisting"]


def _uncertified(velocity: Float[Array, " n"]) -> Estimate:
    return Estimate(velocity, jnp.ones_like(velocity[0]), jnp.asarray(False))


class FilteredDerivative(AbstractObserver):
    """`pF[q]`, the derivative of the filtered position, shape `(n,)`; it lags by what the
    filter does.

    - `filter`: strictly proper, settled at the first position.

    Source: theory, section 7.
    """

    filter: AbstractFilter

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> Estimate:
        del u
        return _uncertified(F.using(self.filter, "exact").p(y, "derivative"))


class HighGain(AbstractObserver):
    """`x1' = x2 + 2 w (q - x1)`, `x2' = a + w^2 (q - x1)`, both poles at -w; the estimate
    is x2, shape `(n,)`.

    - `bandwidth` w (rad/s), shape `()` or `(n,)`;
    - `system`: with one, a is its acceleration at q and x2; without, zero, and x2 lags
      behind the velocity by `2/w` times the acceleration.

    Source: Khalil, Nonlinear Systems, 3rd ed., 2002, section 14.5; theory, section 7.
    """

    bandwidth: Float[Array, "*n"] = eqx.field(converter=real)
    system: AbstractMechanicalSystem | None = None

    def __check_init__(self) -> None:
        positive("bandwidth", self.bandwidth, "rad/s")

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> Estimate:
        w = jnp.broadcast_to(self.bandwidth, y.shape)
        if self.system is not None:
            check_shapes("HighGain", self.system.signals_of(y.shape[0]), u, y)

        def drive(x):
            model = 0.0 * y
            if self.system is not None:
                model = self.system.acceleration(y, x[1], u)
            q = F.trust * y
            return jnp.stack([2.0 * w * q, model + w * w * q])

        law = Switched(_DoublePole(w), _Free(w), F.missing)
        start = jnp.stack([y, jnp.zeros_like(y)]).astype(jnp.result_type(y, w))
        return _uncertified(F.evolve(law, drive, start, "position_velocity")[1])


class _Free(AbstractLaw):
    """`x1' = x2 + v1`, `x2' = v2`, x of shape `(2, n)`, for a velocity that moves on alone;
    `like` has the type of x."""

    like: Float[Array, " n"]

    def flow(self, X: PyTree, v: PyTree) -> Any:
        return jnp.stack([X[1], jnp.zeros_like(X[1])]) + v

    def discretise(self, h: Any) -> Any:
        return jnp.asarray(h, self.like.dtype)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        h, gained = coefficients, 0.5 * coefficients * (v0 + v1)
        return X + gained + jnp.stack([h * (X[1] + 0.5 * gained[1]), 0.0 * X[1]])


class _DoublePole(AbstractLaw):
    """`x' = [[-2 w, 1], [-w^2, 0]] x + v` for each entry of w, x of shape `(2, n)`."""

    w: Float[Array, " n"]

    def _systems(self) -> LinearSystem:
        one, zero = jnp.ones_like(self.w), jnp.zeros_like(self.w)
        return self._with([-2.0 * self.w, one], [-(self.w**2), zero])

    def _with(self, *rows) -> LinearSystem:
        A = jnp.stack([jnp.stack(row, axis=1) for row in rows], axis=1)
        return jax.vmap(LinearSystem)(A)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        flow = jax.vmap(LinearSystem.flow, (0, 1, 1), 1)
        return flow(self._systems(), X, v)

    def discretise(self, h: RealArray | float) -> PyTree:
        # In the coordinates (x1, x2/w), where A is w times a matrix of the size of one:
        # otherwise the exponential loses the digits of w in single precision.
        w = self.w
        balanced = self._with([-2.0 * w, w], [-w, jnp.zeros_like(w)])
        found = jax.vmap(LinearSystem.discretise, (0, None))(balanced, h)
        unit = jnp.stack([jnp.ones_like(w), w], axis=1)
        return jax.tree.map(lambda c: c * (unit[:, :, None] / unit[:, None, :]), found)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        advance = jax.vmap(LinearSystem.advance, (0, 1, 1, 1, 0), 1)
        return advance(self._systems(), X, v0, v1, coefficients)


class SuperTwisting(AbstractObserver):
    """Levant's differentiator: `x1' = x2 + 1.5 sqrt(L |e|) sign e`, `x2' = 1.1 L sign e`,
    `e = q - x1`; the estimate is x2, shape `(n,)`. Without noise it is exact after a finite
    time.

    - `bound` L: of the acceleration (m/s^2 or rad/s^2), shape `()` or `(n,)`.

    Sampled, it is discretised implicitly, which does not chatter.

    Source: Levant 1998, doi:10.1016/S0005-1098(97)00209-4; Mojallizadeh, Brogliato, Acary
    2021, doi:10.1002/rnc.5451; theory, section 7.
    """

    bound: Float[Array, "*n"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        positive("bound", self.bound, "m/s^2 or rad/s^2")

    def equations(self, F: Pass, u: PyTree, y: Float[Array, " n"]) -> Estimate:
        del u
        law = _SuperTwist(jnp.broadcast_to(self.bound, y.shape), F.trust)
        start = jnp.stack([y, jnp.zeros_like(y)]).astype(jnp.result_type(y, self.bound))
        return _uncertified(F.evolve(law, y, start, "position_velocity")[1])


class _SuperTwist(AbstractLaw):
    """The law of [`SuperTwisting`][], driven by q where `trust` is not zero."""

    bound: Float[Array, " n"]
    trust: Float[Array, ""] | float

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        e = self.trust * (v - X[0])
        size = jnp.abs(e)
        root = jnp.sqrt(jnp.where(size > 0, size, 1.0)) * (size > 0)
        first = X[1] + 1.5 * jnp.sqrt(self.bound) * root * jnp.sign(e)
        return jnp.stack([first, 1.1 * self.bound * jnp.sign(e)])

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.bound.dtype)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        # e+ + h 1.5 sqrt(L |e+|) sign e+ + h^2 1.1 L sign e+ = e, the error predicted: with
        # the sign as a set at zero there is one solution for every e.
        h, L = coefficients, self.bound
        predicted = X[0] + h * X[1]
        e = self.trust * (v1 - predicted)
        step, root = 1.1 * L * h * h, 1.5 * h * jnp.sqrt(L)
        rest = jnp.abs(e) - step
        outside = rest > 0
        rest = jnp.where(outside, rest, 0.0)
        half = 0.5 * (jnp.sqrt(root * root + 4.0 * rest) - root)
        sign = jnp.where(outside, jnp.sign(e), e / step)
        return jnp.stack([predicted + e - sign * half**2, X[1] + 1.1 * L * h * sign])
