"""The Swapping Lemma in samples, exact however far apart they are.

A filter with a first-order hold, `w1 = a w0 + left s0 + right s1`, filters a sequence. With
`x0 = S x1 - e` over an interval, what it makes of products `s = c'x` is `X1'x1 - E1`, where
X is the filtered c and E, into which b is injected, what is known of it:

    X1 = a S'X0 + left S'c0 + right c1
    E1 = a (E0 + X0'e) + left (b0 + c0'e) + right b1

What is known at the left end is carried to the x of the right end, and nothing but the
known derivative `x' = A x + z` is taken for a line between samples. With short intervals
this is `X' = A_f X + c - X A` and `E' = A_f E + b + X z`.

Source: theory, section 8.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._laws import AbstractLaw
from ._small import contract
from ._typing import PyTree, RealArray

__all__ = [
    "FACTOR",
    "INFORMATION",
    "KNOWN",
    "PRODUCT",
    "ROW",
    "Carried",
    "Motion",
    "Swapped",
    "Turning",
]

TERMS = 5  # of the exponential of A over an interval, of which one seldom sees the second


class Motion(NamedTuple):
    """The known derivative `x' = A x + z`: `z`, shape `(n,)`, and `A`, shape `(n, n)`, or
    `None` for zero."""

    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None = None


class Back(NamedTuple):
    """The x of the left end of an interval by that of the right one, `x0 = S x1 - e`; an S
    of `None` is one."""

    S: Float[Array, "n n"] | None
    e: Float[Array, " n"]

    def row(self, r: Array) -> Array:
        """`r S`."""
        return r if self.S is None else r @ self.S

    def column(self, v: Array) -> Array:
        """`S'v`."""
        return v if self.S is None else self.S.T @ v


def back(left: Motion, right: Motion, h: RealArray) -> Back:
    """Over an interval of `h` seconds whose ends are given: z is a line in it, and A its
    mean."""
    h = jnp.asarray(h, left.z.dtype)
    if left.A is None or right.A is None:
        return Back(None, 0.5 * h * (left.z + right.z))
    turn, e = -0.5 * h * (left.A + right.A), jnp.zeros_like(left.z)
    S = one = jnp.eye(left.z.shape[0], dtype=left.z.dtype)
    for k in reversed(range(TERMS)):
        S = one + (turn / (k + 1)) @ S
        e = h * (left.z / (k + 1) + right.z) / (k + 2) + (turn @ e) / (k + 1)
    return Back(S, e)


class Turning(NamedTuple):
    """What the factor of a quadratic relation turns by, `H (Q z)'` where `H' = A_f H + B`:
    `H` and `B`, shape `(order,)`; `Q`, shape `(n, n)` or `()`."""

    H: Array
    B: Array
    Q: Array

    def by(self, of: Array, z: Array) -> Array:
        """`of (Q z)'`."""
        Qz = self.Q * z if self.Q.ndim == 0 else contract(self.Q, z)
        return jnp.multiply.outer(of, Qz)


class Carried(NamedTuple):
    """The drive of a state that is carried along with x.

    - `b`: what is injected into it, as its law takes it; the `motion` of x;
    - `X`, what is multiplied by z, and `w`, what is injected there; how X is `turning`.
    """

    b: PyTree
    motion: Motion
    X: Array | None = None
    w: Array | None = None
    turning: Turning | None = None


class Rule(NamedTuple):
    """How a state is carried: what is `added(state, drive)` to its derivative, and what a
    state, or an injection, was at the left end of an interval as seen from its right one,
    `carried(state, factor, turned, back)`, with the factor that is multiplied by z, or the
    injection into it, and what that turns by."""

    added: Callable[[Array, Carried], Array]
    carried: Callable[[Array, Any, Any, Back], Array]


def _turned(of: Carried, X: Array) -> Array:
    motion, turning = of.motion, of.turning
    assert turning is not None
    turn = turning.by(turning.H, motion.z)
    return turn if motion.A is None else turn - X @ motion.A


# Rows, `X' = A_f X + c - X A`.
ROW = Rule(
    lambda X, v: jnp.zeros_like(X) if v.motion.A is None else -X @ v.motion.A,
    lambda X, factor, turned, by: by.row(X),
)
# Those of a quadratic relation, which turn.
FACTOR = Rule(lambda X, v: _turned(v, X), lambda X, factor, turned, by: by.row(X + turned))
# What is known of a row, `E' = A_f E + b + X z`. A factor that turns over the interval
# counts as it is in the middle, since x'Qx is a parabola.
PRODUCT = Rule(
    lambda E, v: contract(v.X, v.motion.z),
    lambda E, factor, turned, by: E + contract(factor + 0.5 * turned, by.e),
)
# The information matrix, and the vector that goes with it.
INFORMATION = Rule(
    lambda M, v: -(v.motion.A.T @ M) - M @ v.motion.A,
    lambda M, factor, turned, by: by.column(by.row(M)),
)
KNOWN = Rule(
    lambda v, of: (
        contract(of.X, of.motion.z) - (0.0 if of.motion.A is None else of.motion.A.T @ v)
    ),
    lambda v, factor, turned, by: by.column(v + contract(factor, by.e)),
)


class Swapped(AbstractLaw):
    """The `law` of a filter for a state that is carried by a `rule`, under a drive that is
    [`Carried`][]. With `means` a signal counts as the mean of its two ends, as in the
    derivative of a line between them."""

    law: AbstractLaw
    rule: Rule = eqx.field(static=True)
    means: bool = eqx.field(static=True, default=False)

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return self.law.flow(X, self.law.mapped(lambda b: b + self.rule.added(X, v), v.b))

    def discretise(self, h: RealArray | float) -> PyTree:
        return self.law.discretise(h), h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        hold, h = coefficients
        by = back(v0.motion, v1.motion, h)
        turning = v0.turning
        of_X, of_w = 0.0, 0.0
        if turning is not None:
            of_X, of_w = (turning.by(each, by.e) for each in (turning.H, turning.B))
        X = self.rule.carried(X, v0.X, of_X, by)
        left = self.law.mapped(lambda b: self.rule.carried(b, v0.w, of_w, by), v0.b)
        right = v1.b
        if self.means:
            left = right = self.law.mapped(lambda a, b: 0.5 * (a + b), left, right)
        return self.law.advance(X, left, right, hold)
