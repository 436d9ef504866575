"""Covariances as factors `P = U D U'`, U upper triangular with ones on its diagonal.

They stay symmetric and positive, and what is known well is as accurate beside what is not
known at all as it is alone: factors see deviations where P sees variances. Straight-line
code: a matrix is a list of rows, and an entry that is a plain 0 or 1 costs nothing.

Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

Rows = list[list[Any]]  # of a matrix: arrays of shape (), or numbers


class Factors(NamedTuple):
    """`P = U D U'`: the entries of U above its diagonal, row by row, shape
    `(N (N - 1)/2,)`, and the diagonal of D, shape `(N,)`, in the squared units of P."""

    upper: Float[Array, " m"]
    pivots: Float[Array, " N"]


def times(a: Any, b: Any) -> Any:
    """`a b`, free where one of them is a plain 0 or 1."""
    if _is(a, 0) or _is(b, 0):
        return 0
    if _is(a, 1):
        return b
    return a if _is(b, 1) else a * b


def plus(a: Any, b: Any) -> Any:
    """`a + b`, free where one of them is a plain 0."""
    if _is(a, 0):
        return b
    return a if _is(b, 0) else a + b


def less(a: Any, b: Any) -> Any:
    """`a - b`, free where b is a plain 0."""
    if _is(b, 0):
        return a
    return -b if _is(a, 0) else a - b


def dot(a: list[Any], b: list[Any]) -> Any:
    """The sum of the products of the entries."""
    total = 0
    for x, y in zip(a, b, strict=True):
        total = plus(total, times(x, y))
    return total


def product(A: Rows, B: Rows) -> Rows:
    """`A B`."""
    columns = [list(column) for column in zip(*B, strict=True)]
    return [[dot(row, column) for column in columns] for row in A]


def unpacked(factors: Factors) -> tuple[Rows, list[Any]]:
    """U as rows, zeros below its diagonal, and the pivots."""
    n = factors.pivots.shape[0]
    rows, k = [], 0
    for i in range(n):
        above = [factors.upper[k + j] for j in range(n - 1 - i)]
        rows.append([0] * i + [1] + above)
        k += n - 1 - i
    return rows, [factors.pivots[j] for j in range(n)]


def packed(U: Rows, d: list[Any], dtype: Any) -> Factors:
    """The factors of U and the pivots `d`."""
    n = len(d)
    above = [U[i][j] for i in range(n) for j in range(i + 1, n)]
    return Factors(stacked(above, dtype), stacked(d, dtype))


def stacked(entries: list[Any], dtype: Any) -> Float[Array, " m"]:
    """A vector of entries, some of which may be plain numbers."""
    if not entries:
        return jnp.zeros(0, dtype)
    return jnp.stack([jnp.asarray(x, dtype) for x in entries])


def array(rows: Rows, dtype: Any) -> Float[Array, "k N"]:
    """A matrix of such rows."""
    return jnp.stack([stacked(row, dtype) for row in rows])


def covariance(U: Rows, d: list[Any], first: int = 0) -> Rows:
    """The rows of P from the entry `first` on, in both."""
    last = len(d)
    P: Rows = [[0] * (last - first) for _ in range(last - first)]
    for j in range(first, last):
        weighted = [times(d[k], U[j][k]) for k in range(j, len(d))]
        for i in range(first, j + 1):
            P[i - first][j - first] = dot(U[i][j:], weighted)
            P[j - first][i - first] = P[i - first][j - first]
    return P


def factored(P: Rows) -> tuple[Rows, list[Any]]:
    """U and the pivots of a positive semidefinite matrix; a direction without variance has
    a zero pivot."""
    n = len(P)
    P = [list(row) for row in P]
    U: Rows = [[0] * i + [1] + [0] * (n - 1 - i) for i in range(n)]
    d: list[Any] = [0] * n
    for j in reversed(range(n)):
        d[j] = P[j][j]
        inverse = reciprocal(d[j]) if j else 0
        for i in range(j):
            U[i][j] = times(P[i][j], inverse)
        for i in range(j):
            for k in range(i, j):
                P[i][k] = P[k][i] = less(P[i][k], times(U[i][j], P[k][j]))
    return U, d


def reciprocal(x: Any) -> Any:
    """`1/x`, and 0 where x is not positive."""
    if _is(x, 0):
        return 0
    return jnp.where(x > 0, 1.0 / jnp.where(x > 0, x, 1.0), 0.0)


def orthogonalised(W: Rows, weights: list[Any]) -> tuple[Rows, list[Any]]:
    """U and the pivots of `W diag(weights) W'`, by weighted Gram-Schmidt (Thornton)."""
    n = len(W)
    W = [list(row) for row in W]
    U: Rows = [[0] * i + [1] + [0] * (n - 1 - i) for i in range(n)]
    d: list[Any] = [0] * n
    for j in reversed(range(n)):
        weighted = [times(w, x) for w, x in zip(weights, W[j], strict=True)]
        d[j] = dot(W[j], weighted)
        if j == 0:
            break
        inverse = reciprocal(d[j])
        weighted = [times(x, inverse) for x in weighted]
        for i in range(j):
            U[i][j] = dot(W[i], weighted)
            W[i] = [less(x, times(U[i][j], y)) for x, y in zip(W[i], W[j], strict=True)]
    return U, d


def measured(
    U: Rows, d: list[Any], f: list[Any], variance: Any, shared: list[Any], moved: Any
) -> tuple[Rows, list[Any], list[Any], Any]:
    """U and the pivots after a scalar measurement `h'X` with noise of `variance`, from `f =
    U'h`; the gain, and one over the variance of the innovation (Bierman). `shared` is `U^-1
    c`, c the covariance of X with that noise. They stay, and the gain is zero, where the
    measurement has not `moved`."""
    n = len(d)
    before, U, d = d, [list(row) for row in U], list(d)
    # The noise as the pivots tell of it; the first one, which is the last to be known,
    # does so without a division of its own.
    told = [times(e, reciprocal(q)) for e, q in zip(shared[1:], d[1:], strict=True)]
    rest = less(variance, dot(shared[1:], told))
    b = [plus(times(q, e), s) for q, e, s in zip(d, f, shared, strict=True)]
    total = plus(rest, times(f[0], plus(b[0], shared[0])))
    inverse = 1.0 / total
    if not _is(b[0], 0):
        left = less(times(d[0], rest), times(shared[0], shared[0]))
        d[0] = jnp.where(moved, left * inverse, d[0])
    b = [e if _is(e, 0) else jnp.where(moved, e, 0.0) for e in b]
    gain: list[Any] = [b[0]] + [0] * (n - 1)
    for j in range(1, n):
        if _is(b[j], 0):
            continue
        slope = plus(f[j], told[j - 1])
        last, ratio = total, times(slope, inverse)
        total = plus(total, times(b[j], slope))
        inverse = 1.0 / total
        d[j] = before[j] * (last * inverse)
        for i in range(j):
            old = U[i][j]
            U[i][j] = less(old, times(gain[i], ratio))
            gain[i] = plus(gain[i], times(b[j], old))
        gain[j] = b[j]
    return U, d, [times(k, inverse) for k in gain], inverse


def transposed_times(U: Rows, h: list[Any]) -> list[Any]:
    """`U'h`."""
    return [dot(h[: j + 1], [U[i][j] for i in range(j + 1)]) for j in range(len(h))]


def divided(U: Rows, c: list[Any]) -> list[Any]:
    """`U^-1 c`."""
    found = list(c)
    for j in reversed(range(len(c))):
        for i in range(j):
            found[i] = less(found[i], times(U[i][j], found[j]))
    return found


def unit_inverse(U: Rows) -> Rows:
    """The inverse of an upper triangular matrix with ones on its diagonal."""
    n = len(U)
    inverse: Rows = [[0] * i + [1] + [0] * (n - 1 - i) for i in range(n)]
    for j in range(n):
        for i in reversed(range(j)):
            total = dot(U[i][i + 1 : j + 1], [inverse[k][j] for k in range(i + 1, j + 1)])
            inverse[i][j] = less(0, total)
    return inverse


def _is(x: Any, value: int) -> bool:
    return isinstance(x, int | float) and x == value
