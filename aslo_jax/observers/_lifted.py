"""The Kalman filter of a relation, which is a linear time-varying system."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import kind, optional_real, positive, real
from .._factored import Rows, array, covariance, dot, less, plus, product, unpacked
from .._guard import Guard
from .._realise import Pass
from .._relations import AbstractTerms, Quadratic
from .._typing import PyTree
from ._base import AbstractObserver, Estimate, check_initial
from ._lifted_filter import LiftedBelief, LiftedKalman, hole_of
from ._lifting import added, entries, quadratic, rows_of, trace


def _deviation(x: Any) -> PyTree:
    """A list is one array."""
    return real(jnp.asarray(x)) if isinstance(x, list) else jax.tree.map(real, x)


class Lifted(AbstractObserver):
    """The Kalman filter of a relation: with one more state for each row, a rate or a
    quadratic relation is a linear time-varying system, and the filter is the best estimate
    from noisy samples. It needs no filter to be chosen, no initial guess and, for a motor,
    no magnet flux, and it cannot diverge.

    - `relation`: `relation(u, y)` gives the terms of one equation in the unmeasured x, or a
      tuple of them, which share z and A;
    - `output_deviation`, `input_deviation`: standard deviations of white noise on every
      sample of y and of u, in their units: one number, or one for each entry, shaped like
      the signal. How it enters the relation follows by automatic differentiation;
    - `prior`: the standard deviation of the first belief of x, in the units of x, shape
      `()` or `(n,)`; by default nothing is known of x;
    - `initial`: x before the first certified instant, shape `(n,)`; zero by default;
    - `guard`: coasting while x is not known; `None` returns the filter's mean as it is;
    - `interval`: in continuous time, of the samples (s) that the deviations belong to.

    The estimate has the `covariance` of x, shape `(n, n)`. Its certificate is between 0 and
    1, `1/(1 + r)`: for a quadratic relation r is the variance of `Q x` beside the square of
    `Q x - c`, the gradient of the relation, which for a motor is that of the angle of the
    magnet in squared radians; for others it is the largest variance of an entry of x beside
    that of the first belief. The default guard lets through what has an r below 1/9.

    Over samples that are missing the covariance grows as if all that is held in their place
    were wrong, in the same way over the whole hole; once x may be off by three times its
    size, the filter begins again.

    Noise in the rows themselves looks like motion. A row is therefore taken to have stayed
    where it was until it has moved significantly: at rest a motor shows nothing of its
    flux, and its covariance stays what it was.

    Source: theory, section 10; Kalman 1960, doi:10.1115/1.3662552; Bierman 1977.

    **Raises:** `ValueError` in continuous time without an `interval`, and for an `initial`
    whose shape is not that of x.
    """

    relation: Callable[[PyTree, PyTree], Any]
    output_deviation: PyTree = eqx.field(converter=_deviation)
    input_deviation: PyTree = eqx.field(converter=_deviation)
    prior: Float[Array, "*n"] | None = eqx.field(converter=optional_real, default=None)
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)
    guard: Guard | None = eqx.field(default_factory=lambda: Guard(0.9))
    interval: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        if not callable(self.relation):
            kind("relation", self.relation, hint="a relation, `relation(u, y)`")
        for name in ("output_deviation", "input_deviation"):
            for leaf in jax.tree.leaves(getattr(self, name)):
                positive(name, leaf)
        if self.prior is not None:
            positive("prior", self.prior)
        if self.interval is not None:
            positive("interval", self.interval, "s")
        kind("guard", self.guard, Guard, hint="a `Guard` or `None`")

    @property
    def law(self) -> LiftedKalman:
        """The filter itself."""
        return LiftedKalman(
            self.relation,
            self.output_deviation,
            self.input_deviation,
            self.prior,
            self.initial,
            self.interval,
        )

    def vector_field(self, t: Any, state: Any, u: PyTree, y: PyTree) -> Any:
        if self.interval is None:
            raise ValueError(
                "Argument `interval` must be given in continuous time, but got None: the "
                "deviations are those of samples, so many seconds apart."
            )
        return super().vector_field(t, state, u, y)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        rows, law = rows_of(self.relation, u, y), self.law
        hole = hole_of(F, rows[0].z.dtype)
        if hole is not None:
            law = law.blind(hole, u, y)
        belief = F.evolve(law, (u, y), law.start(u, y), "belief")
        return self.judged(F, belief, rows)

    def judged(
        self, F: Pass, belief: LiftedBelief, rows: tuple[AbstractTerms, ...]
    ) -> Estimate:
        """The estimate of a belief."""
        dtype = rows[0].z.dtype
        U, d = unpacked(belief.factors)
        r = len(added(rows)) - added(rows).count(None)
        P = covariance(U, d, r)
        x = belief.mean[r:]
        certificate = self.certificate(rows, x, P)
        found = array(P, dtype)
        if self.guard is None:
            return Estimate(x, certificate, jnp.asarray(False), found)
        initial = jnp.zeros_like(x) if self.initial is None else self.initial
        check_initial(initial, x)
        value, coasting = self.guard(F.scope("guard"), x, certificate, rows[0], initial)
        return Estimate(value, certificate, coasting, found)

    def certificate(
        self, rows: tuple[AbstractTerms, ...], x: Float[Array, " n"], P: Rows
    ) -> Float[Array, ""]:
        """From 0, where x is not known, to 1."""
        n = x.shape[0]
        curved = tuple(row for row in rows if isinstance(row, Quadratic))
        if curved:
            return curved_certificate(curved, x, P)
        first = self.law.variance(n, x.dtype)
        worst = jnp.max(jnp.stack([P[i][i] / first[i] for i in range(n)]))
        return 1.0 / (1.0 + worst)


def curved_certificate(
    rows: tuple[Quadratic, ...], x: Float[Array, " n"], P: Rows
) -> Float[Array, ""]:
    """`1/(1 + r)`, r the variance of `Q x` beside the square of `Q x - c`."""
    size: Any = 0
    variance: Any = 0
    for row in rows:
        Q = quadratic(row, x.shape[0])
        gradient = [less(dot(q, entries(x)), row.c[i]) for i, q in enumerate(Q)]
        size = plus(size, dot(gradient, gradient))
        variance = plus(variance, trace(product(Q, Q), P))
    return size / (size + variance)
