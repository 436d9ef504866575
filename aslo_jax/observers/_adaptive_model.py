"""A quadratic relation some of whose leaves are unknown: the model of [`Adaptive`][].

The unknowns are kept as relative errors, `leaf = nominal (1 + error)`, after the entries of
x. The row is measured by the distance to it: by how many standard deviations the noise of y
must be moved, at least, for the row to hold. That has the variance one wherever x is, and
does not vanish at a wrong solution, as the noise of the row itself does.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from .._factored import Rows, array, dot, less, product, stacked, times
from .._module import Module
from .._relations import Quadratic
from .._small import safe_reciprocal, safe_rsqrt
from .._sparsity import listed
from .._typing import PyTree
from ._lifting import Noise, Relation, entries, noise_of, quadratic, rows_of, scaled, spread

OPPOSITE = 1e-6  # less one, the cosine of directions between which no way is the shortest


class Entry(NamedTuple):
    """How noise enters, in its standard deviations: the change of z by that of u and of y,
    shapes `(n, m)` and `(n, p)`; of c, shape `(n, p)`, and of d, shape `(p,)`, by y."""

    z_by_u: Float[Array, "n m"]
    z_by_y: Float[Array, "n p"]
    c: Float[Array, "n p"]
    d: Float[Array, " p"]


def leaf_of(relation: Any, name: str) -> Any:
    """A leaf of a relation by its name, or that of one of its `parameters`, as a derived
    relation has them; `None` where it has none."""
    found = getattr(relation, name, None)
    parameters = getattr(relation, "parameters", None)
    return parameters.get(name) if found is None and isinstance(parameters, dict) else found


class Model(Module):
    """A relation with `parameters`, the names of its leaves that are not known."""

    relation: Relation
    parameters: tuple[str, ...] = eqx.field(static=True)
    output_deviation: PyTree[Float[Array, "..."]]
    input_deviation: PyTree[Float[Array, "..."]]

    def nominal(self) -> Float[Array, " q"]:
        """The values of the parameters in the relation, in their units."""
        return jnp.stack([jnp.asarray(leaf_of(self.relation, k)) for k in self.parameters])

    def at(self, errors: Float[Array, " q"]) -> Relation:
        """The relation with these relative errors of the parameters taken out."""
        relation = self.relation
        values = self.nominal() * (1.0 + errors)
        for k, name in enumerate(self.parameters):
            leaf = lambda r, name=name: leaf_of(r, name)
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

    def noise(self, errors: Float[Array, " q"], u: PyTree, y: PyTree) -> Noise:
        """How the noise of u and y enters."""
        deviations = self.input_deviation, self.output_deviation
        return noise_of(self.at(errors), u, y, *deviations)

    def entry(self, errors: Float[Array, " q"], u: PyTree, y: PyTree) -> Entry:
        """The same, as arrays."""
        noise, dtype = self.noise(errors, u, y), self.dtype(u, y)
        row = noise.rows[0]
        of = lambda rows: array(rows, dtype)
        return Entry(of(noise.z_by_u), of(noise.z_by_y), of(row.c), stacked(row.d, dtype))

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
    """By how much a row does not hold, of the variance `size` wherever x is: the distance
    of the row in standard deviations of y, times the root of the size, which no step needs.
    `mean`, what it is expected to be by the curvature of the row along y. Its slopes by x
    and the errors of the parameters, n + q of them, and by y in its deviations, p of them,
    whose square is the size; `Q` of the row."""

    value: Any
    mean: Any
    slope: list[Any]
    by_y: list[Any]
    size: Any
    Q: Rows

    def bent(self, P: Rows) -> Rows:
        """Its curvature by x, across its slope, times P, symmetric, the covariance of x."""
        n = len(P)
        g = self.slope[:n]
        over = safe_reciprocal(dot(g, g))

        def across(X: Rows) -> Rows:
            along = [times(over, dot(g, list(column))) for column in zip(*X, strict=True)]
            return [
                [less(e, times(a, b)) for e, b in zip(row, along, strict=True)]
                for row, a in zip(X, g, strict=True)
            ]

        bent = product(self.Q, across(P))
        return bent if self._round else across(bent)

    @property
    def _round(self) -> bool:
        """Whether Q is a number times the identity, so that what is across stays so."""
        Q = self.Q
        return all(
            Q[i][j] is Q[0][0] if i == j else isinstance(Q[i][j], int)
            for i in range(len(Q))
            for j in range(len(Q))
        )


def distance(
    model: Model, X: list[Any], u: PyTree, y: PyTree, smooth: Float[Array, " p"]
) -> Distance:
    """That of the row at y, to the second order; slopes at a y that is `smooth`, flat:
    noise that is in both a slope and what it is multiplied by would look like
    information."""
    flat, unflat = ravel_pytree(y)
    n = len(X) - len(model.parameters)
    x, errors = jnp.stack(X[:n]), jnp.stack(X[n:])
    s = spread_of(model, y)
    like = jax.tree.map(jnp.zeros_like, y)  # of which only the shape counts
    of = model, x, errors, u, like
    # Slopes where the row holds: x may be far from it at the start.
    w = smooth / s
    H = listed(_bends_by_y, *of, w)
    w = w - _to_row(_missed(*of, w), listed(_slopes_by_y, *of, w), H)
    J = listed(_slopes_by_y, *of, w)
    foot = unflat(s * w)
    row = model.row(errors, u, foot)
    slope = entries(row.times(x) - row.c) + listed(_slopes_by_errors, *of[:4], foot)
    size, bend = dot(J, J), dot(J, [dot(line, J) for line in H])
    inverse, value = safe_reciprocal(size), _missed(*of, flat / s)
    bend = bend * inverse  # along the slope
    value = value / (1.0 + jnp.maximum(0.5 * bend * (value * inverse), -0.5))
    mean = 0.5 * (sum(H[k][k] for k in range(len(J))) - bend)
    return Distance(value, mean, slope, J, size, quadratic(row, n))


def _missed(
    model: Model, x: Array, errors: Array, u: PyTree, like: PyTree, w: Float[Array, " p"]
) -> Float[Array, ""]:
    """By how much the row does not hold at w, the y in its standard deviations, `like` one
    of its kind."""
    _, unflat = ravel_pytree(like)
    return missed(model.row(errors, u, unflat(spread_of(model, like) * w)), x)


def _slopes_by_y(*args: Any) -> Float[Array, " p"]:
    return jax.jacfwd(_missed, argnums=5)(*args)


def _bends_by_y(*args: Any) -> Float[Array, "p p"]:
    return jax.jacfwd(jax.jacfwd(_missed, argnums=5), argnums=5)(*args)


def _slopes_by_errors(
    model: Model, x: Array, errors: Array, u: PyTree, y: PyTree
) -> Float[Array, " q"]:
    return jax.jacfwd(lambda e: missed(model.row(e, u, y), x))(errors)


def motion_by_errors(
    model: Model, errors: Float[Array, " q"], u: PyTree, y: PyTree
) -> Float[Array, "n q"]:
    """How z depends on the errors of the parameters."""
    return jax.jacfwd(lambda e: model.row(e, u, y).z)(errors)


def _to_row(value: Any, J: list[Any], H: Rows) -> Float[Array, " p"]:
    """How far, along its slope J, a quadratic function with this value and the second
    derivative H is zero."""
    # In the unit of the curvature, in which squares of squares are moderate.
    bends = [jnp.abs(e) for row in H for e in row if not (isinstance(e, int) and e == 0)]
    most = functools.reduce(jnp.maximum, bends, jnp.zeros_like(value))
    unit = jnp.where(most > 0, 1.0 / jnp.where(most > 0, most, 1.0), 1.0)
    J, value = [times(e, unit) for e in J], value * unit
    size, bend = dot(J, J), dot(J, [dot(row, J) for row in scaled(H, unit)])
    # The nearer root of `value - size t + bend t^2/2 = 0`, t along J.
    square = size * size - 2.0 * bend * value
    root = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
    t = 2.0 * value * safe_reciprocal(size + root)
    return jnp.stack([e * t for e in J])


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


class Turn(NamedTuple):
    """What takes the unit vector `before` the shortest way to the `direction` of another
    one: `y - both (both'y) over + 2 after (before'y)`, `both` their sum, of which `over` is
    half of the square."""

    before: Float[Array, " p"]
    direction: Float[Array, " p"]
    both: Float[Array, " p"]
    over: Float[Array, ""]
    turns: Bool[Array, ""]

    @classmethod
    def between(
        cls, before: Float[Array, " p"], after: Float[Array, " p"], size: Float[Array, ""]
    ) -> "Turn":
        """To the direction of a vector of any `size`, its square."""
        # By one quotient: lengths come late, and quotients of them later.
        length = jnp.where(size > 0, jnp.sqrt(jnp.where(size > 0, size, 1.0)), 0.0)
        along = length + jnp.sum(before * after)
        turns = along > OPPOSITE * length
        over = 1.0 / jnp.where(turns, length * along, 1.0)
        direction = jnp.where(turns, after * (along * over), -before)
        return cls(before, direction, length * before + after, over, turns)

    def of(self, y: Float[Array, " p"]) -> Float[Array, " p"]:
        """y turned; as it is, where the vectors are opposite."""
        back = self.over * jnp.sum(self.both * y)
        moved = y - back * self.both + 2.0 * jnp.sum(self.before * y) * self.direction
        return jnp.where(self.turns, moved, y)
