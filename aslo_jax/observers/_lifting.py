"""A relation as a linear time-varying system, with its noise: the model of [`Lifted`][].

Every row of a relation but a linear one has a state of its own, sigma, before those of x:

- rate, `c'x = d + s'`: `sigma = s`, `sigma' = c'x - d`, measured: `s = sigma`;
- quadratic, `1/2 x'Q x = c'x + d`: `sigma = 1/2 x'Q x`, `sigma' = (Q z)'x`, measured:
  `-d = c'x - sigma`;
- linear, `c'x = d`: none, measured: `d = c'x`.

Source: theory, section 10.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._factored import Rows, dot, less, plus, product, times
from .._relations import AbstractTerms, Linear, Quadratic, Rate, Rows as Several
from .._signals import check_signals
from .._sparsity import listed
from .._typing import PyTree

Relation = Callable[[PyTree, PyTree], AbstractTerms | tuple[AbstractTerms, ...]]


def rows_of(relation: Relation, u: PyTree, y: PyTree) -> tuple[AbstractTerms, ...]:
    """The terms of every row of a relation at `u` and `y`, checked."""
    check_signals(relation, type(relation).__call__, u, y)
    found = relation(u, y)
    rows = tuple(found) if isinstance(found, tuple | list) else (found,)
    every: list[AbstractTerms] = []
    for row in rows:
        if not isinstance(row, Linear | Rate | Quadratic | Several):
            raise ValueError(
                "Argument `relation` must return terms `Linear`, `Rate`, `Quadratic` or "
                f"`Rows`, or a tuple of them, but got a {type(row).__name__}."
            )
        row.check(relation)
        every += _single(row) if isinstance(row, Several) else [row]
    return tuple(every)


def _single(rows: Several) -> list[AbstractTerms]:
    """Each of several rows by itself."""
    k, z, A = jnp.shape(rows.s)[0], rows.z, rows.A
    both = [(rows.C[j], rows.d[j]) for j in range(jnp.shape(rows.d)[0])]
    found: list[AbstractTerms] = [
        Rate(c=c, s=rows.s[j], z=z, d=d, A=A) for j, (c, d) in enumerate(both[:k])
    ]
    return found + [Linear(c=c, d=d, z=z, A=A) for c, d in both[k:]]


def added(rows: tuple[AbstractTerms, ...]) -> list[int | None]:
    """The index of sigma of each row, where it has one."""
    found: list[int | None] = []
    for row in rows:
        count = sum(k is not None for k in found)
        found.append(None if isinstance(row, Linear) else count)
    return found


def entries(x: Array) -> list[Any]:
    """The entries of a vector."""
    return [x[i] for i in range(x.shape[0])]


def matrix(X: Array) -> Rows:
    """The rows of a matrix."""
    return [entries(X[i]) for i in range(X.shape[0])]


class Sensitivity(NamedTuple):
    """How the noise of y, or of u, enters one row: the changes of c, shape `(n, p)`, and of
    d and s, shape `(p,)`, by one standard deviation of each entry of it; plain zeros where
    it does not."""

    c: Rows
    d: list[Any]
    s: list[Any]

    def regressors(self) -> Rows:
        """The covariance of the noise of c."""
        return squares(self.c)


class Noise(NamedTuple):
    """How one standard deviation of the noise of each entry of u and y changes z, shapes
    `(n, m)` and `(n, p)`, and each row, `rows` by y and `rows_by_u`."""

    z_by_u: Rows
    z_by_y: Rows
    rows: tuple[Sensitivity, ...]
    rows_by_u: tuple[Sensitivity, ...]

    def z(self) -> Rows:
        """The covariance of the noise of z in one sample."""
        return squares([a + b for a, b in zip(self.z_by_u, self.z_by_y, strict=True)])


def noise_of(
    relation: Relation, u: PyTree, y: PyTree, input_deviation: Any, output_deviation: Any
) -> Noise:
    """How white noise of u and y, of these standard deviations, enters the terms: by their
    derivatives."""
    (by_u, rows_by_u), (by_y, rows) = (
        _entering(which, relation, u, y, spread(deviation, (u, y)[which], name))
        for which, name, deviation in (
            (0, "input", input_deviation),
            (1, "output", output_deviation),
        )
    )
    return Noise(by_u, by_y, rows, rows_by_u)


def _entering(
    which: int, relation: Relation, u: PyTree, y: PyTree, deviations: Float[Array, " p"]
) -> tuple[Rows, tuple[Sensitivity, ...]]:
    """What one of these deviations of each entry of u, or of y, changes in z and rows."""
    by, each = listed(_slopes, which, relation, u, y)
    s = entries(deviations)
    line = lambda row: [times(e, q) for e, q in zip(row, s, strict=True)]
    of_row = lambda c, d, e: Sensitivity([line(row) for row in c], line(d), line(e))
    return [line(row) for row in by], tuple(of_row(*one) for one in each)


def _slopes(which: int, relation: Relation, u: PyTree, y: PyTree) -> PyTree:
    """The derivatives of z, and of c, d and s of each row, by u (0) or y (1), flat."""
    v, back = ravel_pytree((u, y)[which])

    def terms(v):
        rows = rows_of(relation, *((back(v), y) if which == 0 else (u, back(v))))
        zero = jnp.zeros_like(rows[0].z[0])
        or_zero = lambda x: zero if x is None else x
        each = [
            (row.c, or_zero(row.d), or_zero(getattr(row, "s", None)))  # pyright: ignore[reportAttributeAccessIssue]
            for row in rows
        ]
        return rows[0].z, each

    return jax.jacfwd(terms)(v)


def spread(deviation: PyTree, like: PyTree, name: str) -> Float[Array, " p"]:
    """A deviation for each entry of a signal, from one like it, or one number for all."""
    structure = jax.tree.structure(like)
    if jax.tree.structure(deviation) != structure:
        leaves = jax.tree.leaves(deviation)
        if len(leaves) != 1 or jnp.ndim(leaves[0]):
            raise ValueError(
                f"Argument `{name}_deviation` must be a number, or have the structure of "
                f"the signal, {structure}, but has {jax.tree.structure(deviation)}."
            )
        deviation = jax.tree.map(lambda _: leaves[0], like)

    def whole(d, x):
        if jnp.ndim(d) and jnp.shape(d) != jnp.shape(x):
            raise ValueError(
                f"Argument `{name}_deviation` must be a number or have the shape "
                f"{jnp.shape(x)} of the signal, but got {jnp.shape(d)}."
            )
        return jnp.broadcast_to(d, jnp.shape(x)).astype(jnp.result_type(x))

    return ravel_pytree(jax.tree.map(whole, deviation, like))[0]


class Motion(NamedTuple):
    """`x -> transition x + shift` over an interval, `weight` the shift by a z that is held;
    no transition is the identity, and the weight is then a number times it."""

    transition: Rows | None
    shift: list[Any]
    weight: Any

    def of(self, x: list[Any]) -> list[Any]:
        """x at the end."""
        moved = x if self.transition is None else [dot(r, x) for r in self.transition]
        return [plus(a, b) for a, b in zip(moved, self.shift, strict=True)]

    def integrated(self, by: Rows) -> Rows:
        """What noise of z adds to x: its measured value less the true one moves the
        estimate, not x."""
        if isinstance(self.weight, list):
            return scaled(product(self.weight, by), -1.0)
        return scaled(by, -self.weight)


def motion_of(left: AbstractTerms, right: AbstractTerms, h: Any) -> Motion:
    """How x moves in `h` seconds between the terms at both ends: `z` on a straight line;
    with A, which is taken as its mean, to the fourth order in h."""
    z0, z1 = left.z, right.z
    if left.A is None:
        return Motion(None, entries(0.5 * h * (z0 + z1)), h)
    assert right.A is not None
    one = jnp.eye(z0.shape[0], dtype=z0.dtype)
    Z = 0.5 * h * (left.A + right.A)
    # phi2 = 1/2 + Z/6 + Z^2/24 + ..., from which exp Z and its integral follow.
    phi2 = one / 2 + Z @ (one / 6 + Z @ (one / 24))
    phi1 = one + Z @ phi2
    shift = h * (phi1 @ z0 + phi2 @ (z1 - z0))
    return Motion(matrix(one + Z @ phi1), entries(shift), matrix(h * phi1))


class Growth(NamedTuple):
    """`sigma -> sigma + a'x + b` over an interval. Noise that adds v to x adds `column'v`,
    and that of u and y `own_by_u` and `own` for each of their entries; `regressors` is the
    covariance of the noise of a."""

    a: list[Any]
    b: Any
    column: list[Any]
    own: list[Any]
    own_by_u: list[Any]
    regressors: Rows


class Measurement(NamedTuple):
    """A scalar measurement: `value = h'x + sign sigma + J'n`, n the noise of the entries of
    y in their standard deviations, and noise of the variance `by_u` of u; `regressors`, the
    covariance of the noise of h, and `common`, of it with that of the value."""

    value: Any
    h: list[Any]
    sign: int
    J: list[Any]
    regressors: Rows | None
    common: list[Any] | None
    by_u: Any


def measurement_of(
    row: AbstractTerms, noise: Sensitivity, noise_of_u: Sensitivity, x: list[Any]
) -> Measurement:
    """The measurement of a row; J at the estimate `x`."""
    if isinstance(row, Rate):
        return Measurement(row.s, [0] * len(x), 1, noise.s, None, None, 0)
    assert isinstance(row, Linear | Quadratic)
    sign = 1.0 if isinstance(row, Linear) else -1.0

    def entering(noise: Sensitivity) -> tuple[list[Any], list[Any]]:
        C, d = noise.c, noise.d
        slopes = [dot([C[i][j] for i in range(len(x))], x) for j in range(len(d))]
        J = [less(times(sign, e), slope) for slope, e in zip(slopes, d, strict=True)]
        return J, [dot(c, J) for c in C]

    (J, common), (I, common_by_u) = entering(noise), entering(noise_of_u)
    common = [plus(a, b) for a, b in zip(common, common_by_u, strict=True)]
    regressors = total(noise.regressors(), noise_of_u.regressors())
    value, sigma = (row.d, 0) if isinstance(row, Linear) else (-row.d, -1)
    return Measurement(value, entries(row.c), sigma, J, regressors, common, dot(I, I))


def total(A: Rows, B: Rows) -> Rows:
    """Their sum."""
    return [
        [plus(a, b) for a, b in zip(p, q, strict=True)] for p, q in zip(A, B, strict=True)
    ]


def growth_of(
    left: AbstractTerms,
    right: AbstractTerms,
    noise: Sensitivity,
    noise_of_u: Sensitivity,
    covariance: Rows,
    motion: Motion,
    x: list[Any],
    h: Any,
) -> Growth:
    """How sigma of a row grows in `h` seconds from the estimate `x`, `covariance` being
    that of the noise of x in that time."""
    n = len(x)
    moved = motion.of(x)
    if isinstance(right, Quadratic):
        Q = quadratic(right, n)
        a = [dot(row, motion.shift) for row in Q]
        QW = product(Q, covariance)
        b = 0.5 * plus(dot(a, motion.shift), sum(QW[i][i] for i in range(n)))
        own: list[Any] = [0] * len(noise.d)
        own_by_u: list[Any] = [0] * len(noise_of_u.d)
        column = [dot(row, moved) for row in Q]
        return Growth(a, b, column, own, own_by_u, product(QW, Q))
    assert isinstance(left, Rate) and isinstance(right, Rate)
    c0, c1 = entries(left.c), entries(right.c)
    half, twelfth = 0.5 * h, h * h / 12.0
    # The trapezoidal rule with its correction by the slopes of c'x at both ends.
    rate = [less(p, q) for p, q in zip(c1, c0, strict=True)]  # of c, times h
    end0, end1 = list(rate), list(rate)
    if left.A is not None and right.A is not None:
        A0, A1 = matrix(left.A), matrix(right.A)
        end0 = [
            plus(r, times(h, dot(c0, [A0[i][j] for i in range(n)])))
            for j, r in enumerate(rate)
        ]
        end1 = [
            plus(r, times(h, dot(c1, [A1[i][j] for i in range(n)])))
            for j, r in enumerate(rate)
        ]
    last = [less(times(half, q), times(h / 12.0, e)) for q, e in zip(c1, end1, strict=True)]
    first = [
        plus(times(half, q), times(h / 12.0, e)) for q, e in zip(c0, end0, strict=True)
    ]
    moved_last = last
    if motion.transition is not None:
        moved_last = [
            dot(last, [motion.transition[i][j] for i in range(n)]) for j in range(n)
        ]
    a = [plus(p, q) for p, q in zip(first, moved_last, strict=True)]
    z0, z1 = entries(left.z), entries(right.z)
    b = plus(dot(last, motion.shift), times(twelfth, less(dot(c0, z0), dot(c1, z1))))
    if left.d is not None and right.d is not None:
        b = b - half * (left.d + right.d)

    def entering(noise: Sensitivity) -> list[Any]:
        C, d = noise.c, noise.d
        slopes = [dot([C[i][j] for i in range(n)], moved) for j in range(len(d))]
        return [times(h, less(e, slope)) for e, slope in zip(d, slopes, strict=True)]

    N = scaled(total(noise.regressors(), noise_of_u.regressors()), h * h)
    column = [times(half, q) for q in c1]
    return Growth(a, b, column, entering(noise), entering(noise_of_u), N)


def quadratic(row: Quadratic, n: int) -> Rows:
    """Q, as rows."""
    if row.Q.ndim:
        return matrix(row.Q)
    return [[row.Q if i == j else 0 for j in range(n)] for i in range(n)]


def scaled(rows: Rows, factor: Any) -> Rows:
    return [[times(factor, e) for e in row] for row in rows]


def trace(A: Rows, P: Rows) -> Any:
    """That of `A P`, both symmetric."""
    total: Any = 0
    for i in range(len(P)):
        for j in range(i, len(P)):
            entry = times(A[i][j], P[i][j])
            total = plus(total, entry if i == j else times(2.0, entry))
    return total


def blurred(m: Measurement, P: Rows) -> Any:
    """The variance that the noise of a row has by what is not known of x; `J'n` is what it
    has by the estimate."""
    return 0 if m.regressors is None else trace(m.regressors, P)


def squares(A: Rows) -> Rows:
    """`A A'`."""
    n = len(A)
    above = {(i, j): dot(A[i], A[j]) for i in range(n) for j in range(i, n)}
    return [[above[min(i, j), max(i, j)] for j in range(n)] for i in range(n)]


# A row tells of x only where it has moved by this many times its variance: what noise of
# the sensors does to it in a second at rest is no motion.
SIGNIFICANT = 64.0


def has_moved(
    m: Measurement, d: list[Any], f: list[Any], P: Rows, gathered: Rows | None
) -> Any:
    """Whether the row of a measurement has moved by more than noise would have it."""
    noise: Any = 0 if m.regressors is None else trace(m.regressors, P)
    if gathered is not None:
        noise = plus(noise, trace(gathered, P))
    signal = dot([times(a, b) for a, b in zip(d, f, strict=True)], f)
    return signal > SIGNIFICANT * noise
