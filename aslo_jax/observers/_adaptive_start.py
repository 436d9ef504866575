"""The start of [`Adaptive`][]: algebraic fits, one for each of a bank of parameters.

Where x has moved by b since the start, the row is linear in the x there:
`(Q b - c)'x + s = d + c'b - b'Q b/2` with one constant s. Least squares, from whose sums
the noise of the regressors has been taken.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._factored import factored
from .._small import safe_reciprocal, solve_definite
from .._typing import PyTree
from ._adaptive_model import Model, matrix_of
from ._lifting import matrix

CERTAIN = 25.0  # times the noise of the regressors that they must have in every direction
FEIGNED = 1.0 / 6.0  # of N^2 times a sample's, what the noise of b does to N regressors


class Fit(NamedTuple):
    """Sums over a window of one member: `moved`, by how much x has, shape `(n,)`; of the
    regressors r, of r r', of the values, of r times them; the noise in r r'."""

    moved: Float[Array, "*j n"]
    r: Float[Array, "*j n"]
    rr: Float[Array, "*j n n"]
    b: Float[Array, "*j"]
    rb: Float[Array, "*j n"]
    noise: Float[Array, "*j n n"]


class Found(NamedTuple):
    """x now, its covariance, whether it is certain, and for how many samples noise takes to
    move x by as much as it moves one row."""

    x: Float[Array, "*j n"]
    covariance: Float[Array, "*j n n"]
    certain: Bool[Array, "*j"]
    steady: Float[Array, "*j"]


def emptied(like: Float[Array, " n"]) -> Fit:
    """No sample."""
    zero, n = jnp.zeros_like(like), like.shape[0]
    square = jnp.zeros((n, n), like.dtype)
    return Fit(zero, zero, square, jnp.zeros((), like.dtype), zero, square)


def joined(fit: Fit, model: Model, errors: Array, u: PyTree, y: PyTree) -> Fit:
    """The fit with one more sample."""
    row, entry = model.row(errors, u, y), model.entry(errors, u, y)
    b = fit.moved
    Qb = row.times(b)
    r, value = Qb - row.c, row.d + jnp.sum(row.c * b) - 0.5 * jnp.sum(b * Qb)
    C = entry.c
    both = C @ (b @ C + entry.d)  # r moves by -C n, the value by (C'b + d)'n
    noise = C @ C.T
    return Fit(
        b,
        fit.r + r,
        fit.rr + r[:, None] * r - noise,
        fit.b + value,
        fit.rb + r * value + both,
        fit.noise + noise,
    )


def fitted(
    fit: Fit, count: Array, model: Model, errors: Array, u: PyTree, y: PyTree, h: Array
) -> Found:
    """What `count` samples, `h` (s) apart, tell."""
    row, entry = model.row(errors, u, y), model.entry(errors, u, y)
    Q, one = matrix_of(row), jnp.eye(fit.r.shape[-1], dtype=fit.r.dtype)
    over = safe_reciprocal(count)
    M = fit.rr - fit.r[:, None] * fit.r * over
    x = solve_definite(M, fit.rb - fit.r * fit.b * over)[0] + fit.moved
    W = h * h * (entry.z_by_u @ entry.z_by_u.T + entry.z_by_y @ entry.z_by_y.T)
    feigned = FEIGNED * count * count * (Q @ W @ Q)
    _, pivots = factored(matrix(M - CERTAIN * (fit.noise + feigned)))
    certain = jnp.all(jnp.stack(pivots) > 0.0)
    J = x @ entry.c + entry.d
    steady = jnp.trace(fit.noise) * over * safe_reciprocal(jnp.trace(Q @ W @ Q))
    inflated = jnp.sum(J * J) * (1.0 + 0.5 * count * count * safe_reciprocal(steady))
    inverse = jnp.stack([solve_definite(M, e)[0] for e in one])
    return Found(x, inflated * inverse + count * W, certain, steady)
