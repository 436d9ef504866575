"""FO3: the algebraic observer without a division (mixing)."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import known_start, optional_real, positive, real
from .._filters import AbstractFilter, AbstractLaw, check_filter
from .._guard import Guard
from .._realise import Pass
from .._relations import AbstractTerms, swap, terms_of
from .._small import safe_reciprocal, solve_rows
from .._typing import FilterStart, PyTree, RealArray
from ._base import AbstractObserver, Estimate
from ._relaxation import relaxation

__all__ = ["FO3"]


class _Drive(NamedTuple):
    determinant: Float[Array, ""]
    numerator: Float[Array, " n"]
    rate: Float[Array, " n"]  # A x + z


class _Mixing(AbstractLaw):
    """`X' = rate + gain D (N - D X)`, D the determinant and N the numerator.

    Sampled: half of the correction, exact for the D and N of the left end, the model, and
    half of the correction of the right end. Second order, stable whatever the gain.
    """

    gain: Float[Array, ""]

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return v.rate + self._correction(X, v, self.gain)

    def _correction(self, X: Array, v: _Drive, weight: Array) -> Array:
        return weight * v.determinant * (v.numerator - v.determinant * X)

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.gain.dtype)

    def _correct(self, X: Array, v: _Drive, h: Array) -> Array:
        rate = self.gain * v.determinant**2
        return X + self._correction(X, v, self.gain * relaxation(rate, h))

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        half = 0.5 * coefficients
        X = self._correct(X, v0, half)
        return self._correct(X + half * (v0.rate + v1.rate), v1, half)


class FO3(AbstractObserver):
    """`x' = A x + z + gain D (N - D x)` with `D = det R` and `N = adj(R) b` of the n rows
    `R x = b` of [`Repeat`][]: each entry of the error obeys `e' = -gain D^2 e` (when A is
    absent), and nothing is divided where D vanishes.

    - `relation`, `filter`, `start`: as for [`AlgebraicObserver`][];
    - `gain`, in 1/(s D^2), D in A^2 for the flux of a PMSM: 1/(s A^4). Any gain is stable
      when sampled;
    - `initial`: x at the first instant, shape `(n,)`, in its units; zero by default.

    The certificate is that of [`Repeat`][]; `coasting` says that it is at rounding, as at
    standstill, where D = 0 and x is carried along its known derivative.

    Source: paper, eq. (asyobsphi2); Pyrkin, Bobtsov, Ortega, Vedyakov, Aranovskiy, Systems
    & Control Letters 133 (2019) 1-8; theory, sections 3 and 7.
    """

    relation: Callable[[PyTree, PyTree], AbstractTerms]
    filter: AbstractFilter
    gain: Float[Array, ""] = eqx.field(converter=real)
    start: FilterStart = eqx.field(static=True, default="exact")
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        positive("gain", self.gain, "1/s over the square of the determinant")
        known_start(self.start)
        check_filter(self.filter)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        F = F.using(self.filter, self.start)
        terms = terms_of(self.relation, u, y)
        rows = [terms.row(F.scope("row"))]
        for k in range(1, rows[0].r.shape[-1]):
            rows.append(swap(F.scope(f"repeat{k}"), rows[-1]))
        R, b = jnp.stack([row.r for row in rows]), jnp.stack([row.b for row in rows])
        unit = safe_reciprocal(jnp.max(jnp.abs(R), axis=0) + rows[0].scale)
        _, certificate = solve_rows(R * unit, b)
        D, N = _cramer(R, b)
        start = jnp.zeros_like(terms.z) if self.initial is None else self.initial
        x = F.evolve(
            _Mixing(self.gain * F.trust),
            lambda x: _Drive(D, N, terms.drift(x)),
            start,
            "mixing",
        )
        return Estimate(x, certificate, ~Guard().certified(certificate))


def _determinant(columns: list[list[Array]]) -> Array:
    """By Laplace's expansion along the first entries, straight-line code for small n."""
    if len(columns) == 1:
        return columns[0][0]
    total = jnp.zeros_like(columns[0][0])
    for k, column in enumerate(columns):
        minor = [other[1:] for j, other in enumerate(columns) if j != k]
        total = total + (-1) ** k * column[0] * _determinant(minor)
    return total


def _cramer(
    R: Float[Array, "n n"], b: Float[Array, " n"]
) -> tuple[Float[Array, ""], Float[Array, " n"]]:
    """`det R` and `adj(R) b`."""
    n = b.shape[0]
    columns = [[R[i, j] for i in range(n)] for j in range(n)]
    right = [b[i] for i in range(n)]
    numerators = [
        _determinant([right if j == k else columns[j] for j in range(n)]) for k in range(n)
    ]
    return _determinant(columns), jnp.stack(numerators)
