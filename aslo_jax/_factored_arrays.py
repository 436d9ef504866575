"""Covariances as factors `P = U D U'`, in arrays: the same as `_factored` for matrices that
are too large to be written out entry by entry, of which no entry is known to be zero.

Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._factored import Factors, reciprocal


def unpacked(factors: Factors) -> Float[Array, "N N"]:
    """U."""
    n = factors.pivots.shape[0]
    above = jnp.zeros((n, n), factors.upper.dtype)
    rows, columns = np.triu_indices(n, 1)
    return above.at[rows, columns].set(factors.upper) + jnp.eye(n, dtype=above.dtype)


def packed(U: Float[Array, "N N"], pivots: Float[Array, " N"]) -> Factors:
    """The factors of U, of which what is above the diagonal counts, and the pivots."""
    rows, columns = np.triu_indices(pivots.shape[0], 1)
    return Factors(U[rows, columns], pivots)


def covariance(U: Float[Array, "k N"], pivots: Float[Array, " N"]) -> Float[Array, "k k"]:
    """P, or from rows of U those of them."""
    return (U * pivots) @ U.T


def propagated(
    W: Float[Array, "N w"], weights: Float[Array, " w"]
) -> tuple[Float[Array, "N N"], Float[Array, " N"]]:
    """U and the pivots of `W diag(weights) W'`, by weighted Gram-Schmidt (Thornton)."""
    n = W.shape[0]
    columns, pivots = [], []
    for j in reversed(range(n)):
        last, W = W[j], W[:j]
        weighted = weights * last
        pivot = jnp.sum(weighted * last)
        above = jnp.sum(W * weighted, axis=1) * reciprocal(pivot)
        W = W - above[:, None] * last
        columns.append(jnp.concatenate([above, _one(j, n, W.dtype)]))
        pivots.append(pivot)
    return jnp.stack(columns[::-1], axis=1), jnp.stack(pivots[::-1])


def updated(
    U: Float[Array, "N N"],
    pivots: Float[Array, " N"],
    f: Float[Array, " N"],
    variance: Float[Array, ""],
) -> tuple[Float[Array, "N N"], Float[Array, " N"], Float[Array, " N"]]:
    """U, the pivots and the gain of a scalar measurement `h'X` with noise of `variance`,
    from `f = U'h` (Bierman)."""
    n = pivots.shape[0]
    columns, found = [], []
    gain, total = jnp.zeros(0, U.dtype), variance
    for j in range(n):
        b, above, before = pivots[j] * f[j], U[:j, j], total
        total = before + b * f[j]
        found.append(pivots[j] * (before / total))
        column = above - gain * (f[j] / before)
        columns.append(jnp.concatenate([column, _one(j, n, U.dtype)]))
        gain = jnp.concatenate([gain + b * above, b[None]])
    return jnp.stack(columns, axis=1), jnp.stack(found), gain / total


def unit_inverse(U: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """The inverse of an upper triangular matrix with ones on its diagonal."""
    n = U.shape[0]
    found = jnp.eye(n, dtype=U.dtype)[n - 1 :]
    for i in reversed(range(n - 1)):
        row = jnp.eye(n, dtype=U.dtype)[i] - U[i, i + 1 :] @ found
        found = jnp.concatenate([row[None], found])
    return found


def _one(j: int, n: int, dtype: jnp.dtype) -> Float[Array, " k"]:
    """From the entry j on, the j-th column of the identity."""
    return jnp.eye(n, dtype=dtype)[j, j:]
