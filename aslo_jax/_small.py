"""Straight-line linear algebra for small systems: it fuses, vectorises and differentiates
where calls to LAPACK do not."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

ROUNDING = 4.0  # a pivot of so many roundings of what it is the rest of is none


def safe_reciprocal(x: Array) -> Array:
    """`1/x`, and 0 where `x` is 0, with finite gradients."""
    zero = x == 0
    return jnp.where(zero, 0.0, 1.0 / jnp.where(zero, 1.0, x))


def safe_rsqrt(x: Array) -> Array:
    """`1/sqrt(x)`, and 0 where `x` is not positive, with finite gradients."""
    positive = x > 0
    return jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def contract(X: Float[Array, "*order n"], z: Float[Array, " n"]) -> Float[Array, "*order"]:
    """`X z`, elementwise so that it fuses with what surrounds it."""
    return jnp.sum(X * z, axis=-1)


def _known_inverse(pivot: Array, least: Array | float) -> tuple[Array, Array]:
    """`1/pivot` and whether the pivot is more than `least`. Where it is not, the inverse is
    huge: a compiler may make a pivot that is rounding twice, with either sign, and what
    then passes for regular must not have a certificate."""
    regular = pivot > least
    huge = float(jnp.finfo(pivot.dtype).tiny) ** -0.5
    return jnp.where(regular, 1.0 / jnp.where(regular, pivot, 1.0), huge), regular


def solve_definite(
    M: Float[Array, "n n"], v: Float[Array, " n"], scale: Float[Array, " n"] | None = None
) -> tuple[Float[Array, " n"], Float[Array, ""]]:
    """Solve `M x = v` for a positive semidefinite M by its factors `L D L'`.

    Returns x and the harmonic mean of the eigenvalues of M, `n / trace(M^-1)`, which is
    between the least eigenvalue and n times it; of M with its rows and columns divided by
    the roots of `scale` where that is given. Where M is singular both are 0.
    """
    n, eps = v.shape[0], float(jnp.finfo(M.dtype).eps)
    below = [[M[i, j] for j in range(n)] for i in range(n)]  # L D
    L = [[jnp.zeros_like(v[0])] * n for _ in range(n)]
    inverse_pivot = []
    regular = jnp.asarray(True)
    for j in range(n):
        pivot = below[j][j] - sum((below[j][k] * L[j][k] for k in range(j)), start=0.0)
        inverted, known = _known_inverse(pivot, ROUNDING * eps * M[j, j])
        regular = regular & known
        inverse_pivot.append(inverted)
        for i in range(j + 1, n):
            known = sum((below[i][k] * L[j][k] for k in range(j)), start=0.0)
            below[i][j] = below[i][j] - known
            L[i][j] = below[i][j] * inverse_pivot[j]
    inverse = [
        [jnp.ones_like(v[0])] * n for _ in range(n)
    ]  # of L, with ones on its diagonal
    for j in range(n):
        for i in range(j + 1, n):
            total = sum((L[i][k] * inverse[k][j] for k in range(j + 1, i)), start=L[i][j])
            inverse[i][j] = -total
    w = [sum((inverse[i][k] * v[k] for k in range(i)), start=v[i]) for i in range(n)]
    w = [w[i] * inverse_pivot[i] for i in range(n)]
    x = [sum((inverse[k][i] * w[k] for k in range(i + 1, n)), start=w[i]) for i in range(n)]
    trace = jnp.zeros_like(v[0])
    for i in range(n):
        squares = (inverse[k][i] ** 2 * inverse_pivot[k] for k in range(i + 1, n))
        entry = sum(squares, start=inverse_pivot[i])  # of the diagonal of M^-1
        trace = trace + (entry if scale is None else scale[i] * entry)
    x = jnp.where(regular, jnp.stack([jnp.asarray(xi) for xi in x]), 0.0)
    return x, jnp.where(regular, n / trace, 0.0)


def solve_rows(
    R: Float[Array, "m n"], b: Float[Array, " m"]
) -> tuple[Float[Array, " n"], Float[Array, ""]]:
    """Solve `R x = b`, m >= n rows of unit size, by modified Gram-Schmidt.

    Returns x (of least squares when m > n) and the harmonic mean of the eigenvalues of
    `R'R / m`. Where R is singular both are 0.
    """
    (m, n), eps = R.shape, float(jnp.finfo(R.dtype).eps)
    columns = [R[:, j] for j in range(n)]
    rest = b
    T = [[jnp.zeros_like(b[0])] * n for _ in range(n)]
    inverse_pivot, projection = [], []
    regular = jnp.asarray(True)
    for j in range(n):
        square = jnp.sum(columns[j] * columns[j])
        least = (ROUNDING * eps) ** 2 * jnp.sum(R[:, j] * R[:, j])
        inverted, known = _known_inverse(square, least)
        regular = regular & known
        inverse_pivot.append(jnp.sqrt(inverted))
        q = columns[j] * inverse_pivot[j]
        for k in range(j + 1, n):
            T[j][k] = jnp.sum(q * columns[k])
            columns[k] = columns[k] - T[j][k] * q
        projection.append(jnp.sum(q * rest))
        rest = rest - projection[j] * q
    inverse = [[jnp.zeros_like(b[0])] * n for _ in range(n)]
    for j in range(n):
        inverse[j][j] = inverse_pivot[j]
        for i in reversed(range(j)):
            total = sum((T[i][k] * inverse[k][j] for k in range(i + 1, j + 1)), start=0.0)
            inverse[i][j] = -total * inverse_pivot[i]
    x = [
        sum((inverse[i][k] * projection[k] for k in range(i, n)), start=0.0)
        for i in range(n)
    ]
    trace = sum(
        (inverse[i][j] ** 2 for j in range(n) for i in range(j + 1)),
        start=jnp.zeros_like(b[0]),
    )
    x = jnp.where(regular, jnp.stack([jnp.asarray(xi) for xi in x]), 0.0)
    return x, jnp.where(regular, n / (m * trace), 0.0)


DOUBLINGS = 20  # the most of an exponential
TERMS = 18  # of its series, the first omitted one below 1e-17


def exponential_integrals(
    Z: Float[Array, "k k"],
) -> tuple[Float[Array, "k k"], Float[Array, "k k"], Float[Array, "k k"]]:
    """`exp Z`, `phi1(Z) = (exp Z - 1)/Z` and `phi2(Z) = (phi1(Z) - 1)/Z`, as power series.

    Of `Z/2^s`, whose size is one at most, then doubled s times: products only, where the
    usual exponential solves systems of equations. Not a number for sizes above 1e6, for
    which s would exceed 20.
    """
    one = jnp.eye(Z.shape[0], dtype=Z.dtype)
    size = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(Z), axis=1)))
    # Comparisons of sizes rather than logarithms, which may miss by one.
    bounds = 2.0 ** jnp.arange(DOUBLINGS + 1, dtype=Z.dtype)
    doublings = jnp.sum(size > bounds)
    small = Z / 2.0 ** doublings.astype(Z.dtype)
    phi2 = jnp.zeros_like(Z)
    for n in reversed(range(TERMS)):
        phi2 = one / float(math.factorial(n + 2)) + small @ phi2
    phi1 = one + small @ phi2
    phi0 = one + small @ phi1

    def double(k, phis):
        phi0, phi1, phi2 = phis
        doubled = (
            phi0 @ phi0,
            0.5 * (phi1 + phi0 @ phi1),
            0.25 * (phi1 @ phi1) + 0.5 * phi2,
        )
        return [jnp.where(k < doublings, a, b) for a, b in zip(doubled, phis, strict=True)]

    found = jax.lax.fori_loop(0, DOUBLINGS, double, [phi0, phi1, phi2])
    fits = doublings <= DOUBLINGS
    phi0, phi1, phi2 = (jnp.where(fits, phi, jnp.nan) for phi in found)
    return phi0, phi1, phi2
