"""Relations between the unmeasured state and measured signals, and their rows.

A relation is any callable `relation(u, y)` that returns the terms of one equation in the
unmeasured `x` at an instant: [`Linear`][], [`Rate`][] or [`Quadratic`][], or of several
at once, [`Rows`][]. `x` has a known
derivative `x' = A x + z` (`A` mostly absent). The Swapping Lemma turns the terms into a
[`Row`][], `r'x = b` with r and b measured, and a row into further rows.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._module import Module
from ._realise import Pass
from ._signals import check_signals
from ._small import contract, safe_rsqrt
from ._swapped import FACTOR, PRODUCT, ROW, Motion, Turning
from ._typing import PyTree

__all__ = [
    "AbstractTerms",
    "Linear",
    "Quadratic",
    "Rate",
    "Row",
    "Rows",
    "contract",
    "filtered_rows",
    "settled",
    "swap",
    "terms_of",
]


class Row(Module):
    """One row `r'x = b`, or a batch of them, with `x' = A x + z`.

    - `r`, shape `(..., n)`; `b`, shape `(...)`; `z`, shape `(n,)`; `A`, shape `(n, n)`, or
      `None` for zero;
    - `scale`, shape `(n,)`: what `r` is measured against, entry by entry; a small `r`
      beside it is rounding and noise;
    - `constant`: whether `r` is a constant once its filters have settled;
    - `honest`: whether the least squares take what they hold for `scale` where that is
      more, so that no certificate is above one: where A varies, `scale` need not be what r
      settles at;
    - `isotropic`: whether the entries of x have one unit and no direction of it is special,
      so that one scale is for all of them: what an entry is measured against must not
      depend on the axes, one of which may have no signal but noise.
    """

    r: Float[Array, "*rows n"]
    b: Float[Array, "*rows"]
    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None
    # What r is measured against, entry by entry: its settled size, or the size of the
    # terms that it is the difference of. A small r beside them is rounding and noise.
    scale: Float[Array, " n"]
    # Whether r is a constant once its filters have settled, which is how the paper's
    # start takes it.
    constant: bool = eqx.field(static=True, default=False)
    honest: bool = eqx.field(static=True, default=False)
    isotropic: bool = eqx.field(static=True, default=False)


class AbstractTerms(Module):
    """The terms of a relation at an instant; `x' = A x + z` with `z` of shape `(n,)`, in
    units of x per second, and `A` of shape `(n, n)`, in 1/s, or `None` for zero.

    **Raises:** `ValueError` where the shapes of terms do not fit.
    """

    z: eqx.AbstractVar[Float[Array, " n"]]
    A: eqx.AbstractVar[Float[Array, "n n"] | None]

    @abc.abstractmethod
    def row(self, F: Pass) -> Row:
        """The relation as a row `r'x = b` free of unmeasured derivatives."""

    def check(self, relation: Callable[..., Any]) -> None:
        """Refuse terms that have broadcast: of `relation`, which is named."""
        beside = jnp.shape(self.z)
        if len(beside) != 1:
            raise ValueError(
                f"The term `z` of a relation must have the shape (n,) of the state, but "
                f"{_name(relation)} gives {beside}; check the shapes of `u` and `y`."
            )
        n = beside[0]
        for name, shape in self.shapes(n).items():
            term = getattr(self, name, None)
            if term is not None and jnp.shape(term) != shape:
                raise ValueError(
                    f"The term `{name}` of a relation must have the shape {shape} beside a "
                    f"`z` of shape {(n,)}, but {_name(relation)} gives {jnp.shape(term)}; "
                    "check the shapes of `u` and `y`."
                )

    def shapes(self, n: int) -> dict[str, tuple[int, ...]]:
        """The shapes that terms must have beside a `z` of n entries."""
        return {"c": (n,), "d": (), "s": (), "A": (n, n)}

    def drift(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """The known derivative `A x + z` at `x` (units of x per second)."""
        return self.z if self.A is None else self.A @ x + self.z


class Linear(AbstractTerms):
    """`c'x = d`, with `x' = A x + z`: already a row (theory, section 2).

    - `c`, shape `(n,)`; `d`, shape `()`; `z`, shape `(n,)`; `A`, shape `(n, n)`, zero by
      default.
    """

    c: Float[Array, " n"]
    d: Float[Array, ""]
    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None = None

    def row(self, F: Pass) -> Row:
        scale = _size(F, self.c, self.A)
        return Row(self.c, self.d, self.z, self.A, scale)


class Rate(AbstractTerms):
    """`c'x = d + s'`, with `x' = A x + z` and `s` measured but not its derivative.

    - `c`, shape `(n,)`; `s` and `d`, shape `()`; `z`, shape `(n,)`; `A`, shape `(n, n)`;
      `d` and `A` are zero by default.

    `b = F[d] + pF[s] + (swapping term)`, `r = F[c]` (theory, section 2; Prop. 1 with
    c = 1, s = y, z = u). `constant=True` declares that c and A do not vary, so that the
    paper's start takes F[c] as settled. `honest=True` keeps the certificate of least
    squares with an A at one at most, as [`Row`][] says.
    """

    c: Float[Array, " n"]
    s: Float[Array, ""]
    z: Float[Array, " n"]
    d: Float[Array, ""] | None = None
    A: Float[Array, "n n"] | None = None
    constant: bool = eqx.field(static=True, default=False)
    honest: bool = eqx.field(static=True, default=False)

    def row(self, F: Pass) -> Row:
        motion, w = Motion(self.z, self.A), F.inject(self.c)
        X = filtered_rows(F, self.c, motion, self.constant, "r", means=True)
        d = jnp.zeros_like(contract(w, self.z)) if self.d is None else F.inject(self.d)
        # With the paper's start a varying c has F[c] from zero; were pF[s] from zero too,
        # the estimate would begin as s(0)/t.
        settled = F.exact or not self.constant
        E = F.carried(PRODUCT, d, motion, "b", X=X, w=w, means=True)
        b = F.p(self.s, "s", settled=settled) + F.output(E)
        scale = _size(F, self.c, self.A, self.constant)
        return Row(F.output(X), b, self.z, self.A, scale, self.constant, self.honest)


class Quadratic(AbstractTerms):
    """`1/2 x'Q x = c'x + d`, with `x' = z` and Q constant and symmetric.

    - `Q`, shape `(n, n)` or `()`; `c`, shape `(n,)`; `d`, shape `()`; `z`, shape `(n,)`;
    - `A`, shape `(n, n)`, zero by default: `x' = A x + z`, where `Q A + A'Q = 0`, as in a
      frame that turns. For any other the quadratic term does not go: its products are
      states then ([`Rows`][]).

    The relation times F[1], less the filtered relation, has no quadratic term left:
    `r = C K - (C H) c`, `b = (C H) d + C W` with `H' = A H + B`,
    `K' = A K + B c' + H (Q z)'`, `W' = A W - B d + K z` (theory, section 2; Prop. 2).
    A constant in d drops out with the exact start. Where Q is a number, that times the
    identity is meant, and the certificate is the same in every frame.
    """

    Q: Float[Array, "n n"] | Float[Array, ""]
    c: Float[Array, " n"]
    d: Float[Array, ""]
    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None = None

    def times(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """`Q x`."""
        return self.Q * x if self.Q.ndim == 0 else contract(self.Q, x)

    def row(self, F: Pass) -> Row:
        H = F.settling("one")
        motion, turning = Motion(self.z, self.A), Turning(H, F.inject(1.0), self.Q)
        w = F.inject(self.c)
        K = F.carried(FACTOR, w, motion, "r", turning=turning)
        known = -F.inject(self.d)
        W = F.carried(PRODUCT, known, motion, "b", X=K, w=w, turning=turning)
        one, k = F.output(H), F.output(K)
        r = k - one * self.c
        b = one * self.d + F.output(W)
        isotropic = self.Q.ndim == 0
        if isotropic:
            total = _length(k) + _length(one * self.c)
            scale = jnp.broadcast_to(total / k.shape[0] ** 0.5, k.shape)
        else:
            scale = jnp.abs(k) + jnp.abs(one * self.c)
        return Row(r, b, self.z, self.A, scale, isotropic=isotropic)


class Rows(AbstractTerms):
    """Several equations at once, `C x = d + s'` with `x' = A x + z`, the last of which may
    have no s: `C x = d`. All are filtered, since a C or d with the input in it may jump.

    - `C`, shape `(m, n)`; `d`, shape `(m,)`; `s`, shape `(k,)` with k at most m; `z`, shape
      `(n,)`; `A`, shape `(n, n)`, zero by default. Rows times a weight are rows: with least
      squares choose it as one over the noise of the row;
    - `constant`: whether C and A are constants.

    Source: theory, section 2, state-affine.
    """

    C: Float[Array, "m n"]
    d: Float[Array, " m"]
    s: Float[Array, " k"]
    z: Float[Array, " n"]
    A: Float[Array, "n n"] | None = None
    constant: bool = eqx.field(static=True, default=False)

    def shapes(self, n: int) -> dict[str, tuple[int, ...]]:
        m, k = jnp.shape(self.d)[0], jnp.shape(self.s)[0]
        return {"C": (m, n), "s": (min(k, m),), "A": (n, n)}

    def row(self, F: Pass) -> Row:
        motion, w = Motion(self.z, self.A), F.inject(self.C)
        X = filtered_rows(F, self.C, motion, self.constant, "r", means=True)
        E = F.carried(PRODUCT, F.inject(self.d), motion, "b", X=X, w=w, means=True)
        b = F.output(E)
        k = self.s.shape[0]
        if k:
            settled = F.exact or not self.constant
            rates = F.p(self.s, "s", settled=settled)
            b = b + rates if k == b.shape[0] else jnp.concatenate([b[:k] + rates, b[k:]])
        return Row(F.output(X), b, self.z, self.A, self._scale(F), self.constant, True)

    def _scale(self, F: Pass) -> Float[Array, " n"]:
        """What the entries of all rows settle at, together: with the A of the start, since
        with one that varies they do not settle."""
        if self.A is None:
            return jnp.sqrt(jnp.sum(self.C**2, axis=0))
        stacked = _size(F, self.C, self.A)
        size = jnp.sqrt(jnp.sum(stacked**2, axis=0))
        return F.state("scale", size, jnp.zeros_like(size))


def terms_of(relation: Callable[..., AbstractTerms], u: PyTree, y: PyTree) -> AbstractTerms:
    """The terms of a relation at `u` and `y`, whose shapes, and those of the terms, are
    what the relation declares and what its kind of terms has.

    **Raises:** `ValueError` for a signal, or terms, of another shape."""
    check_signals(relation, type(relation).__call__, u, y)
    terms = relation(u, y)
    terms.check(relation)
    return terms


def _length(x: Float[Array, " n"]) -> Float[Array, ""]:
    square = jnp.sum(x * x)
    return square * safe_rsqrt(square)


def _name(relation: Callable[..., Any]) -> str:
    return f"`{getattr(relation, '__name__', type(relation).__name__)}`"


def filtered_rows(
    F: Pass,
    r: Float[Array, "*rows n"],
    motion: Motion,
    constant: bool,
    name: str,
    *,
    means: bool = False,
) -> Float[Array, "*order_rows n"]:
    """`X' = A_f X + B r' - X A`, the hidden state of the filtered rows, with a rule that
    takes `means` as [`Pass.carried`][] says.

    Constant rows are taken as settled with the paper's start.
    """
    injected, A = F.inject(r), motion.A
    if constant and not F.exact:
        drive = injected if A is None else lambda X: injected - X @ A
        still = F.filter.equilibrium(r) if A is None else _settled_rows(F, injected, A)
        return F.standing(drive, still, name)
    return F.carried(ROW, injected, motion, name, means=means)


def _size(
    F: Pass,
    c: Float[Array, "*rows n"],
    A: Float[Array, "n n"] | None,
    constant: bool = False,
) -> Array:
    """What the entries of a filtered row settle at; A spreads c over all of them."""
    if A is None:
        return jnp.abs(c)
    # A scale only: the estimate does not depend on it, so neither does its gradient. The
    # rows of a mode that F is no faster than do not settle.
    settled = jax.lax.stop_gradient(F.output(_settled_rows(F, F.inject(c), A)))
    size = jnp.abs(c) + jnp.where(jnp.isfinite(settled), jnp.abs(settled), 0.0)
    return F.state("scale", size, jnp.zeros_like(size)) if constant else size


def _settled_rows(F: Pass, injected: Array, A: Float[Array, "n n"]) -> Array:
    return settled(lambda X: F.filter.flow(X, injected) - X @ A, injected)


def settled(rate: Callable[[Array], Array], like: Array) -> Array:
    """The X of the shape of `like` with `rate(X) = 0`, `rate` being affine."""

    def flat(X):
        return rate(X.reshape(like.shape)).reshape(-1)

    zero = jnp.zeros(like.size, like.dtype)
    return jnp.linalg.solve(jax.jacfwd(flat)(zero), -flat(zero)).reshape(like.shape)


def swap(F: Pass, row: Row) -> Row:
    """A further row from a `row`, or from a batch of them, by the Swapping Lemma.

    `F[r'x] = F[b]` becomes `(C X + D r')x = C E + D b` with `X' = A_f X + B r' - X A` and
    `E' = A_f E + X z + B b` (theory, section 2, general filter; paper, App. A).
    """
    b, motion = F.inject(row.b), Motion(row.z, row.A)
    X = filtered_rows(F, row.r, motion, row.constant, "r")
    E = F.carried(PRODUCT, b, motion, "b", X=X, w=F.inject(row.r))
    r = F.output(X) + F.filter.feedthrough(row.r)
    b = F.output(E) + F.filter.feedthrough(row.b)
    return dataclasses.replace(row, r=r, b=b)
