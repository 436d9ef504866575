"""A quadratic relation some of whose leaves are unknown: the model of [`Adaptive`][].

The unknowns are kept as relative errors, `leaf = nominal (1 + error)`, after the entries of
x. The row is measured by the distance to it: by how many standard deviations the noise of y
must be moved, at least, for the row to hold. That has the variance one wherever x is, and
does not vanish at a wrong solution, as the noise of the row itself does.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._factored import array
from .._module import Module
from .._relations import Quadratic
from .._small import safe_reciprocal, safe_rsqrt
from .._typing import PyTree
from ._lifting import Relation, noise_of, quadratic, rows_of, spread


class Entry(NamedTuple):
    """How noise enters, in its standard deviations: the change of z by that of u and of y,
    shapes `(n, m)` and `(n, p)`; of c, shape `(n, p)`, and of d, shape `(p,)`, by y."""

    z_by_u: Float[Array, "n m"]
    z_by_y: Float[Array, "n p"]
    c: Float[Array, "n p"]
    d: Float[Array, " p"]


class Model(Module):
    """A relation with `parameters`, the names of its leaves that are not known."""

    relation: Relation
    parameters: tuple[str, ...] = eqx.field(static=True)
    output_deviation: PyTree[Float[Array, "..."]]
    input_deviation: PyTree[Float[Array, "..."]]

    def nominal(self) -> Float[Array, " q"]:
        """The values of the parameters in the relation, in their units."""
        return jnp.stack([jnp.asarray(getattr(self.relation, k)) for k in self.parameters])

    def at(self, errors: Float[Array, " q"]) -> Relation:
        """The relation with these relative errors of the parameters taken out."""
        relation = self.relation
        values = self.nominal() * (1.0 + errors)
        for k, name in enumerate(self.parameters):
            leaf = lambda r, name=name: getattr(r, name)
            relation = eqx.tree_at(leaf, relation, values[k])
        return relation

    def row(self, errors: Float[Array, " q"], u: PyTree, y: PyTree) -> Quadratic:
        """The terms."""
        rows = rows_of(self.at(errors), u, y)
        if len(rows) != 1 or not isinstance(rows[0], Quadratic):
            raise ValueError(
                "Argument `relation` must return one `Quadratic` row, but got "
                f"{[type(row).__name__ for row in rows]}; `Lifted` takes others."
            )
        return rows[0]

    def entry(self, errors: Float[Array, " q"], u: PyTree, y: PyTree) -> Entry:
        """How the noise of u and y enters."""
        deviations = self.input_deviation, self.output_deviation
        noise, dtype = noise_of(self.at(errors), u, y, *deviations), self.dtype(u, y)
        row = noise.rows[0]
        return Entry(array(noise.z_by_u, dtype), array(noise.z_by_y, dtype), row.c, row.d)

    def dtype(self, u: PyTree, y: PyTree) -> Any:
        return self.row(jnp.zeros_like(self.nominal()), u, y).z.dtype


def matrix_of(row: Quadratic) -> Float[Array, "n n"]:
    """Q, as a matrix."""
    n = row.z.shape[0]
    return array(quadratic(row, n), row.z.dtype)


def missed(row: Quadratic, x: Float[Array, " n"]) -> Float[Array, ""]:
    """By how much a row does not hold."""
    return 0.5 * jnp.sum(x * row.times(x)) - jnp.sum(row.c * x) - row.d


class Distance(NamedTuple):
    """The distance of a row, in standard deviations of y, of the variance one; `mean`, what
    it is expected to be by the curvature of the row along y. Its slopes by x and the errors
    of the parameters, shape `(n + q,)`, and by y in its deviations, shape `(p,)`, of size
    one; its curvature by x, shape `(n, n)`."""

    value: Float[Array, ""]
    mean: Float[Array, ""]
    slope: Float[Array, " N"]
    direction: Float[Array, " p"]
    curvature: Float[Array, "n n"]


def distance(
    model: Model, X: Float[Array, " N"], u: PyTree, y: PyTree, smooth: Float[Array, " p"]
) -> Distance:
    """That of the row at y, to the second order; slopes at a y that is `smooth`, flat:
    noise that is in both a slope and what it is multiplied by would look like
    information."""
    flat, unflat = ravel_pytree(y)
    n = X.shape[0] - len(model.parameters)
    x, errors = X[:n], X[n:]
    s = spread_of(model, y)

    def at(w):  # w: y in its standard deviations
        return missed(model.row(errors, u, unflat(s * w)), x)

    # Slopes where the row holds: x may be far from it at the start.
    w = smooth / s
    H = jax.jacfwd(jax.jacfwd(at))(w)
    w = w - _to_row(at, H, w)
    foot = unflat(s * w)
    row = model.row(errors, u, foot)
    gradient = row.times(x) - row.c
    J = jax.jacfwd(at)(w)
    inverse = safe_rsqrt(jnp.sum(J * J))
    along = J * inverse
    by_errors = jax.jacfwd(lambda e: missed(model.row(e, u, foot), x))(errors)
    slope = jnp.concatenate([gradient, by_errors]) * inverse
    over = safe_reciprocal(jnp.sum(gradient * gradient))
    across = jnp.eye(n, dtype=x.dtype) - (over * gradient)[:, None] * gradient
    curvature = across @ matrix_of(row) @ across * inverse

    bend = jnp.sum(along * (H @ along)) * inverse
    value = at(flat / s) * inverse
    value = value / (1.0 + jnp.maximum(0.5 * bend * value, -0.5))
    mean = 0.5 * (jnp.trace(H) * inverse - bend)
    return Distance(value, mean, slope, along, curvature)


def _to_row(
    at: Callable[[Array], Array], H: Float[Array, "p p"], w: Float[Array, " p"]
) -> Float[Array, " p"]:
    """How far from w, along its slope, a quadratic function with the second derivative H is
    zero."""
    value, J = at(w), jax.jacfwd(at)(w)
    inverse = safe_rsqrt(jnp.sum(J * J))
    size, along = jnp.sum(J * J) * inverse, J * inverse
    # The nearer root of `value - size t + bend t^2/2 = 0`.
    square = size * size - 2.0 * jnp.sum(along * (H @ along)) * value
    root = square * safe_rsqrt(square)
    return along * (2.0 * value * safe_reciprocal(size + root))


def slope_by_y(
    model: Model, X: Float[Array, " N"], u: PyTree, y: PyTree
) -> tuple[Float[Array, " p"], Float[Array, ""]]:
    """The direction in which y in its deviations moves the row most, of size one; and one
    over by how much."""
    flat, unflat = ravel_pytree(y)
    n = X.shape[0] - len(model.parameters)
    s = spread_of(model, y)
    J = jax.jacfwd(lambda w: missed(model.row(X[n:], u, unflat(s * w)), X[:n]))(flat / s)
    inverse = safe_rsqrt(jnp.sum(J * J))
    return J * inverse, inverse


def spread_of(model: Model, y: PyTree) -> Float[Array, " p"]:
    """The deviation of every entry of y, flat."""
    return spread(model.output_deviation, y, "output")


def turned(
    y: Float[Array, " p"], before: Float[Array, " p"], after: Float[Array, " p"]
) -> Float[Array, " p"]:
    """y turned as the shortest way takes one unit vector to another."""
    both = before + after
    mirrored = 1.0 + jnp.sum(before * after)
    along = jnp.sum(both * y) * safe_reciprocal(mirrored)
    return jnp.where(
        mirrored > 1e-6, y - along * both + 2.0 * jnp.sum(before * y) * after, y
    )
