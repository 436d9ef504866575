"""Changes of coordinates `T(y) x` from a dictionary of functions of what is measured.

A covector `t(y)'x` whose derivative has no product of states is sought among combinations
of the functions of y that the model itself has, and their products: a null space. For a
body that turns it finds the angular momentum in the frame at rest.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import symbols
from .closure import echelon
from .lifted import Lowered
from .polynomials import Points, Polynomial, Sampled, Top, add, multiply
from .symbols import Program, Symbolic, program

UNKNOWNS = 160  # the most coefficients of a covector
ATOMS = ("sin", "cos", "exp")
VANISHES = 1e-9  # relative singular value of what is solved
CONDITION = 1e4  # the most of T at a point


@dataclasses.dataclass(frozen=True, eq=False)
class Matrix:
    """`T(y)`, of covectors whose entries are `combinations`, shape `(n, n, m)`, of products
    of the functions that `atoms` gives for the parameters `p`, with those of `pairs`."""

    combinations: np.ndarray
    atoms: Program
    pairs: tuple[tuple[int, int], ...]
    p: tuple[float, ...]

    def __call__(self, y: Float[Array, " p"]) -> Float[Array, "n n"]:
        return _matrix(self, y)

    symbolic = False  # it holds for the present values of the parameters

    def into(
        self, x: Float[Array, " k"], y: Float[Array, " p"], p: Sequence[Any]
    ) -> Float[Array, " k"]:
        """The new coordinates of states `x`, unknown parameters as they are."""
        del p
        n = len(self.combinations)
        return jnp.concatenate([jnp.sum(self(y) * x[:n], axis=1), x[n:]])

    def back(
        self, x: Float[Array, " k"], y: Float[Array, " p"], p: Sequence[Any]
    ) -> Float[Array, " k"]:
        """The states of new coordinates `x`."""
        del p
        n = len(self.combinations)
        return jnp.concatenate([_solved(self(y), x[:n]), x[n:]])


@functools.partial(jax.jit, static_argnums=0)  # traced once, and not at every use
def _matrix(change: Matrix, y: Float[Array, " p"]) -> Float[Array, "n n"]:
    values = _products(change.atoms, change.pairs, change.p, y)
    rows = [
        [
            sum(
                (float(c) * v for c, v in zip(entry, values, strict=True) if c),
                0.0 * y[0],
            )
            for entry in row
        ]
        for row in change.combinations
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def _solved(T: Array, x: Array) -> Array:
    """`T^-1 x`, by cofactors where they are few: without a choice of pivots."""
    n = len(x)
    if n > 3:
        return jnp.linalg.solve(T, x)
    if n == 1:
        return x / T[0]
    if n == 2:
        adjugate = jnp.stack(
            [
                jnp.stack([T[1, 1], -T[0, 1]]),
                jnp.stack([-T[1, 0], T[0, 0]]),
            ]
        )
    else:
        a, b, c = T
        adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=1)
    determinant = jnp.sum(T[0] * adjugate[:, 0])
    return jnp.sum(adjugate * x, axis=1) / determinant


def _products(atoms: Program, pairs: Any, p: Any, y: Array) -> list[Array]:
    values = [jnp.asarray(v, y.dtype) for v in atoms({"y": y, "p": p})]
    return [values[i] * values[j] for i, j in pairs]


def covectors(lowered: Lowered) -> Matrix | None:
    """As many covectors as there are states, `None` where there are fewer."""
    model, graph = lowered.model, lowered.graph
    n = len(model.states)
    rows = {k: p for kind, k, p in lowered.rows if kind == "rate"}
    polynomials = [*lowered.rates, *rows.values()]
    lacking = len(rows) < len(model.outputs)
    if n < 2 or lacking or any(isinstance(p, Top) for p in polynomials):
        return None
    atoms = [graph.one]
    for number, node in enumerate(graph.nodes):
        inputs = {kind for kind, _ in graph.inputs(number)}
        own = node.op == "input" and node.data[0] == "y"
        if own or (node.op in ATOMS and "y" in inputs and inputs <= {"y", "p"}):
            atoms.append(number)
    every = [(i, j) for i in range(len(atoms)) for j in range(i, len(atoms))]
    if n * len(every) > UNKNOWNS:
        return None
    code, p = program(graph, atoms), tuple(float(v) for v in model.values())
    algebra = lowered.sampled(0)
    of, slope = with_slopes(code, p, algebra.points, len(model.outputs))
    left, right = (list(side) for side in zip(*every, strict=True))
    values = of[:, left] * of[:, right]
    slopes = of[:, left, None] * slope[:, right] + slope[:, left] * of[:, right, None]
    _, kept = echelon(values)  # of functions that depend on each other, one
    slopes = slopes[:, kept]
    null = _null(lowered, algebra, values[:, kept], slopes)
    picked = _independent(null.reshape(len(null), n, len(kept)), values[:, kept])
    if picked is None:
        return None
    return Matrix(picked, code, tuple(every[k] for k in kept), p)


def with_slopes(
    code: Program, p: tuple[float, ...], points: Points, outputs: int
) -> tuple[np.ndarray, np.ndarray]:
    """The functions of y in `code`, shape `(N, a)`, and their slopes, shape `(N, a, p)`, at
    the good points: as a graph, which needs no compiler."""

    def single(y: Array) -> Array:
        return jnp.stack([jnp.asarray(v, y.dtype) for v in code({"y": y, "p": p})])

    graph, count = Symbolic(), len(code.roots)
    both = lambda y: jnp.concatenate([single(y), jax.jacfwd(single)(y).ravel()])
    nodes = symbols.lowered(graph, both, {"y": outputs})
    there = Points(points.inputs, 0, "nothing")
    there.good = points.good
    values = np.stack([value for value, _ in there.of(graph, nodes)], axis=1)
    return values[:, :count], values[:, count:].reshape(-1, count, outputs)


def _null(
    lowered: Lowered, algebra: Sampled, values: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """The combinations whose derivative has no product of states, in echelon form."""
    n = len(lowered.model.states)
    rates = [algebra.at(p) for p in lowered.rates[:n]]
    outputs = [algebra.at(p) for kind, _, p in lowered.rows if kind == "rate"]
    columns: list[Polynomial] = []
    for k in range(n):
        for a in range(values.shape[1]):
            total: Polynomial = {}
            weights = [*slopes[:, a].T, values[:, a]]
            parts = [multiply(algebra, q, {(k,): algebra.number(1.0)}) for q in outputs]  # pyright: ignore[reportArgumentType]
            for weight, part in zip(weights, [*parts, rates[k]], strict=True):
                if not isinstance(part, dict):
                    return np.zeros((0, n * values.shape[1]))
                total = add(algebra, total, {m: c * weight for m, c in part.items()})
            columns.append(total)
    products = sorted({m for p in columns for m in p if len(m) > 1})
    zero = np.zeros(len(values))
    M = np.concatenate(
        [np.stack([p[m][0] if m in p else zero for p in columns], axis=1) for m in products]
    )
    size = np.abs(M).max(axis=0)
    size[size == 0] = 1.0
    # Of a tall matrix the triangular factor has the same rows.
    W = np.linalg.qr(M / size, mode="r") if len(M) > M.shape[1] else M / size
    _, singular, V = np.linalg.svd(W, full_matrices=True)
    rank = int((singular > VANISHES * singular[0]).sum())
    return echelon(V[rank:] / size)[0]


def _independent(null: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Of covectors, the simplest that are independent at every point."""
    n = null.shape[1]
    picked: list[int] = []
    for k in sorted(range(len(null)), key=lambda k: np.count_nonzero(null[k])):
        T = np.einsum("rka,na->nrk", null[[*picked, k]], values)
        if np.linalg.matrix_rank(T[0], 1e-6) == len(picked) + 1:
            picked.append(k)
        if len(picked) == n:
            T = np.einsum("rka,na->nrk", null[picked], values)
            good = np.median(np.linalg.cond(T)) < CONDITION
            return null[picked] if good else None
    return None
