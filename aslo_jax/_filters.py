"""Filters: the linear laws that an observer's equations are written in."""

import functools
import operator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._checks import optional_real, positive, real, stable
from ._laws import (
    AbstractFilter,
    AbstractLaw,
    Hold,
    Integrator,
    Remembering,
    check_filter,
    held,
    scalar_hold,
)
from ._small import exponential_integrals
from ._typing import PyTree, RealArray
from ._varying import AbstractSchedule, Schedule

__all__ = [
    "AbstractFilter",
    "AbstractLaw",
    "Integrator",
    "LinearFilter",
    "LinearSystem",
    "LowPass",
    "bias_rejecting",
    "check_filter",
    "second_order",
    "sinusoid_rejecting",
]


SQUARINGS = 30  # the N-th root of a constant is then 1 but for some parts in a billion


def _rate(x: Any) -> Any:
    if isinstance(x, AbstractSchedule) or type(x) is object:
        return x
    schedule: Any = Schedule
    return schedule(x) if callable(x) else real(x, "rate")


class LowPass(AbstractFilter):
    """`F(s) = rate / (s + rate)`, the filter of the paper (eq. fil), `rate` in rad/s: a
    number, or a schedule of a rate that varies, or a function of the time (s) and of the
    signals u and y that gives one ([`Schedule`][aslo_jax.schedules.Schedule]).

    Its state is the filtered signal itself; that of a rate that varies is the signal over
    the rate.

    Source: theory, sections 2, 8 and 12; paper, eq. (fil).

    **Raises:** `ValueError` for a `rate` that is neither a positive number nor a schedule.
    """

    rate: Float[Array, ""] | AbstractSchedule = eqx.field(converter=_rate)

    def __check_init__(self) -> None:
        if isinstance(self.rate, AbstractSchedule):
            return
        positive("rate", self.rate, "rad/s")
        if jnp.ndim(self.rate) and isinstance(self.rate, jax.Array):
            raise ValueError(
                "Argument `rate` must be a number (rad/s), but got an array of shape "
                f"{self.rate.shape}; make one filter for each rate, by `jax.vmap` or in a "
                "`FilterBank`."
            )

    @property
    def constant(self) -> RealArray:
        """The rate where it is a number (rad/s).

        **Raises:** `ValueError` where it varies."""
        if isinstance(self.rate, AbstractSchedule):
            raise ValueError(
                "Argument `filter` must have a constant rate here, but its rate is a "
                f"`{type(self.rate).__name__}`, which only a pass knows; give "
                "`LowPass(number)`."
            )
        return self.rate

    @property
    def slowest(self) -> RealArray:
        """The rate, or the least one of a schedule (rad/s)."""
        if isinstance(self.rate, AbstractSchedule):
            return self.rate.limits[0]
        return self.rate

    @property
    def varies(self) -> bool:
        return isinstance(self.rate, AbstractSchedule)

    @property
    def strictly_proper(self) -> bool:
        return True

    def inject(self, s: RealArray | float) -> RealArray:
        return self.constant * s

    def output(self, X: RealArray) -> RealArray:
        return X

    def feedthrough(self, s: RealArray | float) -> RealArray | float:
        return 0.0

    def equilibrium(self, s: RealArray | float) -> RealArray:
        return jnp.asarray(s, jnp.result_type(s, self.constant))

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return v - self.constant * X

    def discretise(self, h: RealArray | float) -> PyTree:
        return scalar_hold(self.constant, jnp.asarray(h, self.constant.dtype))

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        return held(coefficients, X, operator.mul, v0, v1)


class LinearSystem(AbstractLaw):
    """`X' = A X + v`, the state of any linear observer; `A` of shape `(k, k)`, in 1/s.

    Sampled exactly for a drive that is linear over the interval.
    """

    A: Float[Array, "k k"] = eqx.field(converter=real)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return jnp.tensordot(self.A, X, axes=1) + v

    def discretise(self, h: RealArray | float) -> PyTree:
        h = jnp.asarray(h, self.A.dtype)
        decay, phi1, phi2 = exponential_integrals(self.A * h)
        right = h * phi2
        lost = -(self.A * h) @ phi1 if decay.dtype == jnp.float32 else None
        return Hold(decay, h * phi1 - right, right, lost)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        return held(coefficients, X, functools.partial(jnp.tensordot, axes=1), v0, v1)


class Switched(AbstractLaw):
    """`measured`, or `alone` where a sample is `missing`: the same state without what is
    measured. Both are driven by what is known in either case."""

    measured: AbstractLaw
    alone: AbstractLaw
    missing: Bool[Array, ""]

    def _either(self, a: PyTree, b: PyTree) -> PyTree:
        return jax.tree.map(lambda a, b: jnp.where(self.missing, a, b), a, b)

    def flow(self, X: PyTree, v: PyTree) -> Any:
        return self._either(self.alone.flow(X, v), self.measured.flow(X, v))

    def discretise(self, h: Any) -> Any:
        return self.measured.discretise(h), self.alone.discretise(h)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        measured, alone = coefficients
        return self._either(
            self.alone.advance(X, v0, v1, alone),
            self.measured.advance(X, v0, v1, measured),
        )


class LinearFilter(AbstractFilter):
    """Any proper stable filter `F(s) = D + C (sI - A)^-1 B` of order `k`.

    - `A`, shape `(k, k)`, in 1/s, with eigenvalues in the left half-plane;
    - `B`, shape `(k,)`; `C`, shape `(k,)`; `D`, a number.

    `D=None` declares it strictly proper, which a rate relation requires (it uses `pF`).

    **Raises:** `ValueError` for shapes that do not fit, and for an `A` that is not stable.
    """

    A: Float[Array, "k k"] = eqx.field(converter=real)
    B: Float[Array, " k"] = eqx.field(converter=real)
    C: Float[Array, " k"] = eqx.field(converter=real)
    D: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        shapes = jnp.shape(self.A), jnp.shape(self.B), jnp.shape(self.C)
        if len(shapes[0]) != 2:
            return  # the base refuses what is no matrix
        if shapes != (2 * shapes[1], shapes[1], shapes[1]):
            raise ValueError(
                "Arguments `A`, `B`, `C` must have shapes (k, k), (k,) and (k,), but got "
                f"{shapes[0]}, {shapes[1]} and {shapes[2]}."
            )
        stable("A", self.A)

    @property
    def strictly_proper(self) -> bool:
        return self.D is None

    def inject(self, s: RealArray | float) -> RealArray:
        return jnp.multiply.outer(self.B, s)

    def output(self, X: RealArray) -> RealArray:
        return jnp.tensordot(self.C, X, axes=1)

    def feedthrough(self, s: RealArray | float) -> RealArray | float:
        return 0.0 if self.D is None else self.D * s

    def equilibrium(self, s: RealArray | float) -> RealArray:
        return jnp.multiply.outer(-jnp.linalg.solve(self.A, self.B), s)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return LinearSystem(self.A).flow(X, v)

    def discretise(self, h: RealArray | float) -> PyTree:
        hold = LinearSystem(self.A).discretise(h)
        # Poles that are alike forget one after the other, later than each by itself.
        slowest = spectral_radius(hold.decay)
        delay = jnp.exp(-jnp.asarray(h, self.A.dtype) / total_delay(self.A))
        return Remembering(hold, slowest, jnp.maximum(slowest, delay))

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        return LinearSystem(self.A).advance(X, v0, v1, coefficients.hold)


def spectral_radius(M: Float[Array, "k k"]) -> Float[Array, ""]:
    """The largest absolute value of the eigenvalues of `M`, which are at most 1: the limit
    of the N-th root of the length of `M^N`, here for N = 2^30.

    Source: Gelfand, 1941, Mat. Sb. 9, 3-24.
    """
    logarithm = jnp.zeros((), M.dtype)
    for k in range(SQUARINGS):
        size = jnp.maximum(jnp.sqrt(jnp.sum(M * M)), jnp.finfo(M.dtype).tiny)
        logarithm = logarithm + jnp.log(size) / 2**k
        M = M / size
        M = M @ M
    return jnp.minimum(jnp.exp(logarithm), 1.0)


def total_delay(A: Float[Array, "k k"]) -> Float[Array, ""]:
    """The sum of the time constants of `X' = A X` (s), `-tr A^-1`, by its characteristic
    polynomial.

    Source: the recursion of Faddeev and Le Verrier; Gantmacher, The Theory of Matrices,
    1959, chapter 4, section 5.
    """
    k = A.shape[0]
    one = jnp.eye(k, dtype=A.dtype)
    product, last, before = A, -jnp.trace(A), jnp.ones((), A.dtype)
    for j in range(2, k + 1):
        product = A @ (product + last * one)
        last, before = -jnp.trace(product) / j, last
    return before / last


def second_order(
    natural_frequency: Float[Array, ""] | float,
    damping: Float[Array, ""] | float = 0.5**0.5,
) -> LinearFilter:
    """`w0^2 / (s^2 + 2 zeta w0 s + w0^2)`, `natural_frequency` w0 in rad/s.

    With `damping = sqrt(1/2)` and `w0 = (W/V)^(1/4)` the algebraic observer of the double
    integrator *is* its steady-state Kalman filter (theory, section 2), W and V being the
    two-sided intensities of the input and measurement noise.
    """
    w, zeta = real(natural_frequency), real(damping)
    positive("natural_frequency", w, "rad/s")
    positive("damping", zeta)
    zero = jnp.zeros_like(w)
    A = jnp.stack([jnp.stack([zero, w]), jnp.stack([-w, -2.0 * zeta * w])])
    return LinearFilter(A, jnp.stack([zero, w]), jnp.stack([zero + 1.0, zero]))


def bias_rejecting(rate: Float[Array, ""] | float) -> LinearFilter:
    """`(2 lam s + lam^2) / (s + lam)^2`, whose derivative at `s = 0` vanishes; `rate`
    lam in rad/s.

    A constant bias on the input of the double integrator then leaves no error (theory,
    section 2), which the paper claims of the first-order filter (O4).
    """
    lam = real(rate)
    positive("rate", lam, "rad/s")
    zero = jnp.zeros_like(lam)
    A = jnp.stack([jnp.stack([zero, lam]), jnp.stack([-lam, -2.0 * lam])])
    return LinearFilter(A, jnp.stack([zero, lam]), jnp.stack([zero + 1.0, zero + 2.0]))


def sinusoid_rejecting(
    rate: Float[Array, ""] | float,
    frequency: Float[Array, ""] | float,
    damping: Float[Array, ""] | float = 0.7,
) -> LinearFilter:
    """A low-pass filter with an internal model of a sinusoid,
    `rate/(s + rate) (s^2 + w0^2)/(s^2 + 2 zeta w0 s + w0^2)`; `rate` and `frequency` w0
    in rad/s, `damping` zeta without a unit.

    Zeros at +-j w0 reject a sinusoid of that frequency on the *sensor* (paper,
    conclusions; theory, section 2). `F[1]` of this form never crosses zero.
    """
    lam, w, zeta = real(rate), real(frequency), real(damping)
    positive("rate", lam, "rad/s")
    positive("frequency", w, "rad/s")
    positive("damping", zeta)
    # The low-pass output x1 drives the notch in controllable form, whose output is
    # x1 - 2 zeta w0 x3, the zeros being those of s^2 + w0^2.
    zero = jnp.zeros_like(lam * w * zeta)
    A = jnp.stack(
        [
            jnp.stack([zero - lam, zero, zero]),
            jnp.stack([zero, zero, zero + w]),
            jnp.stack([zero + 1.0, zero - w, -2.0 * zeta * w + zero]),
        ]
    )
    B = jnp.stack([zero + lam, zero, zero])
    C = jnp.stack([zero + 1.0, zero, -2.0 * zeta * w + zero])
    return LinearFilter(A, B, C)
