"""The asymptotic observer (A-ASLO): an algebraic estimate smoothed along the model."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import kind, optional_real, positive, real
from .._filters import AbstractLaw, LowPass
from .._realise import Pass
from .._small import safe_reciprocal
from .._typing import PyTree, RealArray
from ._algebraic import AlgebraicObserver
from ._base import AbstractObserver, Estimate, check_initial

__all__ = ["Asymptotic"]


class _Average(NamedTuple):
    """The state: a weight N in [0, 1] and N times the estimate."""

    weight: Float[Array, ""]
    weighted: Float[Array, " n"]

    def estimate(self) -> Float[Array, " n"]:
        return self.weighted * safe_reciprocal(self.weight)


class _Drive(NamedTuple):
    value: Float[Array, " n"]
    certified: Bool[Array, ""]
    trust: Float[Array, ""]  # the weight of the correction in continuous time
    rate: Float[Array, " n"]  # of the estimate, along the model
    error: Float[Array, " n"]  # value less estimate


class _Correction(AbstractLaw):
    """`x' = rate + gain trust (value - x) / N` with `N' = gain trust (1 - N)`.

    This is the swapped pair F[1], F[x] of the low-pass filter of `gain`, frozen while
    nothing is certified: N starts at 0 to forget the initial guess at the first certified
    instant, or at 1 to keep it, which is the printed law.
    """

    gain: Float[Array, ""]

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        gain = self.gain * v.trust
        return _Average(
            gain * (1.0 - X.weight),
            gain * (v.value - X.weighted) + X.weight * v.rate,
        )

    def discretise(self, h: RealArray | float) -> PyTree:
        return LowPass(self.gain).discretise(h), h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        # Propagated along the model, then corrected by the innovation under first-order
        # hold: exact for the true state, second order for what the filter sees of errors.
        hold, h = coefficients
        half = jnp.asarray(0.5 * h, X.weighted.dtype)
        predicted = X.estimate() + half * (v0.rate + v1.rate)
        innovation = v1.value - predicted
        left = jnp.where(v0.certified, v0.error, innovation)
        corrected = self.gain * (hold.left * left + hold.right * innovation)
        lost = 1.0 - hold.decay if hold.lost is None else hold.lost
        weight = hold.decay * X.weight + lost
        weight = jnp.where(v1.certified, weight, X.weight)
        corrected = jnp.where(v1.certified, corrected, 0.0)
        return _Average(weight, weight * predicted + corrected)


class Asymptotic(AbstractObserver):
    """The A-ASLO: `x' = z - gain (x - x_algebraic)`, `gain` in rad/s.

    It corrects only while the algebraic observer is certified, and otherwise coasts. With
    the exact start its error is `e(0) exp(-gain t)`; with the paper's the slower of `gain`
    and the filter's rate shows (the paper, Cor. 1, claims `gain`).

    - `observer`: the algebraic observer that it follows;
    - `initial`: the user's estimate at the first instant, shape `(n,)`, kept and left at
      the rate `gain`. By default the estimate is the algebraic one at the first certified
      instant.

    Source: paper, Cor. 1 and P2 of Props 2 to 5; theory, section 4.
    """

    observer: AlgebraicObserver
    gain: Float[Array, ""] = eqx.field(converter=real)
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        positive("gain", self.gain, "rad/s")
        kind("observer", self.observer, AlgebraicObserver, hint="an `AlgebraicObserver`")

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        algebraic = self.observer(F.scope("algebraic"), u, y)
        terms = self.observer.relation(u, y)
        guard, certified = self.observer.guard, ~algebraic.coasting
        one = jnp.ones_like(algebraic.certificate)
        trust = one if guard is None else guard.trust(algebraic.certificate)
        if self.initial is None:
            start = _Average(0.0 * one, jnp.zeros_like(algebraic.value))
        else:
            check_initial(self.initial, algebraic.value)
            start = _Average(one, self.initial)

        def drive(X: _Average) -> _Drive:
            x = X.estimate()
            error = algebraic.value - x
            return _Drive(algebraic.value, certified, trust, terms.drift(x), error)

        X = F.evolve(_Correction(self.gain), drive, start, "average")
        value = jnp.where(X.weight > 0, X.estimate(), algebraic.value)
        return Estimate(value, algebraic.certificate, algebraic.coasting)
