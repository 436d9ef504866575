"""The smallest space of polynomials that holds the rows of a model and their derivatives.

Rows are the polynomials of the rates of measured signals, and of equations. Their values at
many points of what is measured span a space V of polynomials with constant coefficients; V
grows by the derivatives of its elements along the model until these lie within it. Then a
basis of V is a state with a derivative that is affine in it (theory, section 2).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .polynomials import Monomial, Polynomial, Ring, Sampled, Top, add, lie, scaled

CANCELLED = 1e-10  # what is left of a coefficient that cancels, to its magnitude
INDEPENDENT = 1e-9  # the least relative singular value of independent polynomials
FRESH = 1e-7  # what may be left of a derivative at points that were not looked at
DIMENSION = 12  # the most states
ROUNDS = 40
Constant = dict[Monomial, float]  # a polynomial with constant coefficients


@dataclasses.dataclass(frozen=True)
class Row:
    """One equation: the `rate` of the measured signal `index`, or the equation `index`."""

    kind: str
    index: int
    polynomial: Polynomial


@dataclasses.dataclass(frozen=True)
class Failure:
    """A row that does not close: `why`, in words; the `node` at which it stops being a
    polynomial, or the monomials that its derivatives bring in without end."""

    kind: str
    index: int
    node: int | None = None
    why: str = ""
    growing: tuple[Monomial, ...] = ()
    at: Constant | None = None


@dataclasses.dataclass(frozen=True)
class Closure:
    """A basis of the space, in echelon form for the monomials `pivots`, of the `rows` that
    close; `structural` if it is spanned by monomials, and no coefficient was found to be
    zero by its value alone."""

    basis: tuple[Constant, ...]
    pivots: tuple[Monomial, ...]
    rows: tuple[Row, ...]
    failures: tuple[Failure, ...]
    structural: bool


class _Search:
    def __init__(self, ring: Ring, algebra: Sampled, rates: list[Polynomial | Top]):
        self.ring = ring
        self.algebra = algebra
        self.rates = rates
        self.structural = True

    def cleaned(self, p: Polynomial) -> Polynomial:
        """Without the coefficients that cancel at every point."""
        kept = {}
        for monomial, c in p.items():
            value, size = c
            if np.any(np.abs(value) > CANCELLED * np.maximum(size, 1e-300)):
                kept[monomial] = c
            else:
                self.structural = False
        return kept

    def values(self, p: Polynomial, monomials: Sequence[Monomial]) -> np.ndarray:
        """The coefficients at every point, shape `(N, monomials)`: at one, where all are
        constants."""
        count = max((c.shape[1] for c in p.values()), default=1)
        zero = np.zeros(count)
        columns = [np.broadcast_to(p[m][0], count) if m in p else zero for m in monomials]
        return np.stack(columns, axis=1)

    def constant(self, b: Constant) -> Polynomial:
        return {m: self.algebra.number(c) for m, c in b.items()}

    def span(self, pool: Sequence[Polynomial]) -> tuple[list[Constant], list[Monomial]]:
        """The echelon basis of what polynomials, at all points, span."""
        monomials = sorted({m for p in pool for m in p if m}, key=lambda m: (len(m), m))
        if not monomials:
            return [], []
        rows, places = echelon(np.concatenate([self.values(p, monomials) for p in pool]))
        basis = [
            {m: float(c) for m, c in zip(monomials, row, strict=True) if c} for row in rows
        ]
        return basis, [monomials[k] for k in places]

    def close(self, row: Row) -> list[Constant] | Failure:
        """The basis of the space of one row."""
        pool, pivots = [row.polynomial], []
        for _ in range(ROUNDS):
            basis, pivots = self.span(pool)
            if len(basis) > DIMENSION:
                grown = tuple(pivots[-4:])
                return Failure(row.kind, row.index, growing=grown)
            pool = [self.constant(b) for b in basis]
            for b in basis:
                derivative = lie(self.ring, self.algebra, self.constant(b), self.rates)
                if isinstance(derivative, Top):
                    grown = tuple(b) if derivative.node < 0 else ()
                    node = None if grown else derivative.node
                    return Failure(
                        row.kind, row.index, node, derivative.why, grown, at=dict(b)
                    )
                pool.append(self.cleaned(derivative))
            if len(self.span(pool)[0]) == len(basis):
                return basis
        return Failure(row.kind, row.index, growing=tuple(pivots[-4:]))


def echelon(M: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """A basis of the rows of M in reduced echelon form, and the columns of its pivots."""
    M = M[np.abs(M).max(axis=1) > 0]
    if not len(M):
        return M, []
    size = np.abs(M).max(axis=0)
    size[size == 0] = 1.0
    W = M / size
    W = W / np.linalg.norm(W, axis=1, keepdims=True)
    # Of a tall matrix the triangular factor has the same rows.
    tall = len(W) > 2 * W.shape[1]
    least = INDEPENDENT * np.sqrt(len(W))
    W = np.linalg.qr(W, mode="r") if tall else W
    _, singular, V = np.linalg.svd(W, full_matrices=False)
    V = V[singular > least * singular[0]]
    V, places = _reduced(V)
    return V * size / size[places][:, None], places


def _reduced(M: np.ndarray, tolerance: float = 1e-8) -> tuple[np.ndarray, list[int]]:
    M, places, row = M.copy(), [], 0
    for column in range(M.shape[1]):
        if row == len(M):
            break
        best = row + int(np.argmax(np.abs(M[row:, column])))
        if abs(M[best, column]) < tolerance:
            M[row:, column] = 0.0
            continue
        M[[row, best]] = M[[best, row]]
        M[row] /= M[row, column]
        others = np.arange(len(M)) != row
        M[others] -= M[others, column][:, None] * M[row]
        places.append(column)
        row += 1
    M = M[:row]
    M[np.abs(M) < tolerance] = 0.0
    return M, places


def close(
    ring: Ring,
    algebra: Sampled,
    rates: list[Polynomial | Top],
    rows: Sequence[tuple[str, int, Polynomial | Top]],
) -> Closure:
    """The space of all rows that close."""
    search = _Search(ring, algebra, rates)
    good, failures, bases, structural = [], [], [], True
    for kind, index, polynomial in rows:
        if isinstance(polynomial, Top):
            failures.append(Failure(kind, index, polynomial.node, polynomial.why))
            continue
        search.structural = True
        row = Row(kind, index, search.cleaned(polynomial))
        if not any(row.polynomial):
            continue
        basis = search.close(row)
        if isinstance(basis, Failure):
            failures.append(basis)
            continue
        structural &= search.structural
        good.append(row)
        bases += [search.constant(b) for b in basis]
    basis, pivots = search.span(bases)
    structural &= all(len(b) == 1 for b in basis)
    return Closure(tuple(basis), tuple(pivots), tuple(good), tuple(failures), structural)


def remainder(
    ring: Ring,
    algebra: Sampled,
    closure: Closure,
    rates: list[Polynomial | Top],
    rows: Sequence[tuple[str, int, Polynomial | Top]],
) -> list[Monomial]:
    """What rows and derivatives have at the points of `algebra` that the basis has not."""
    search = _Search(ring, algebra, rates)
    good = {(row.kind, row.index) for row in closure.rows}
    looked = [p for kind, index, p in rows if (kind, index) in good]
    looked += [lie(ring, algebra, search.constant(b), rates) for b in closure.basis]
    left = []
    for p in looked:
        if isinstance(p, Top):
            raise AssertionError(p.why)
        rest: Polynomial = {m: c for m, c in p.items() if m}
        minus = algebra.number(-1.0)
        for pivot, b in zip(closure.pivots, closure.basis, strict=True):
            if pivot in p:
                part = scaled(algebra, search.constant(b), p[pivot] * minus)
                rest = add(algebra, rest, part)
        left += [
            m
            for m, (value, size) in rest.items()
            if np.any(np.abs(value) > FRESH * np.maximum(size, 1e-300))
        ]
    return left
