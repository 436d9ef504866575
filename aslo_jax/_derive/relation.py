"""The relation of a closure: its terms as straight-line code of u, y and the parameters."""

from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._module import Module
from .._relations import AbstractTerms, Linear, Quadratic, Rate, Rows
from .closure import CANCELLED, Closure, Constant
from .lifted import Lowered
from .polynomials import Monomial, Nodes, Sampled, Top, lie
from .symbols import Program, program

Kind = Literal["linear", "rate", "quadratic", "rows"]
Entries = list[int]  # nodes


class DerivedRelation(Module):
    """What [`derive`][] found, as a relation: `relation(u, y)` gives the terms of it.

    - `parameters`: those of the model, by name; none where the relation holds for their
      present values only, which are in it then;
    - `kind`: of its terms, `"linear"`, `"rate"`, `"quadratic"` or `"rows"`;
    - `program`: the code of its terms; `size`: how many entries its x has; `sizes`: of u
      and of y; `rates`: the outputs whose rates it uses; `constant`: whether c and A are
      constants; `fixed`: parameters that are no longer any.
    """

    parameters: dict[str, Array]
    kind: Kind = eqx.field(static=True)
    program: Program = eqx.field(static=True)
    size: int = eqx.field(static=True)
    sizes: tuple[int, int] = eqx.field(static=True)
    rates: tuple[int, ...] = eqx.field(static=True, default=())
    constant: bool = eqx.field(static=True, default=False)
    fixed: tuple[float, ...] = eqx.field(static=True, default=())

    @property
    def values(self) -> tuple[Any, ...]:
        """The parameters of the model, in order."""
        return tuple(self.parameters.values()) or self.fixed

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        """The shapes of u and y."""
        m, p = self.sizes
        return {"u": (m,), "y": (p,)}

    def __call__(self, u: Float[Array, " m"], y: Float[Array, " p"]) -> AbstractTerms:
        p = self.values
        left = iter(self.program({"u": u, "y": y, "p": p}))
        dtype = jnp.result_type(float, u, y) if p == () else jnp.result_type(u, y, *p)
        n = self.size

        def taken(*shape: int) -> Any:
            count = int(np.prod(shape, dtype=int))
            found = [jnp.asarray(next(left), dtype) for _ in range(count)]
            return jnp.stack(found).reshape(shape) if shape else found[0]

        z = taken(n)
        A = taken(n, n) if next(left) else None
        if self.kind == "quadratic":
            round_ = next(left)
            Q = taken() if round_ else taken(n, n)
            return Quadratic(Q=Q, c=taken(n), d=taken(), z=z, A=A)
        s: list[Any] = [y[k] for k in self.rates]
        if self.kind == "rows":
            m = int(next(left))
            C, d, weights = taken(m, n), taken(m), [next(left) for _ in s]
            weighted = [x if w == 1.0 else w * x for x, w in zip(s, weights, strict=True)]
            s_ = jnp.stack(weighted) if s else jnp.zeros(0, dtype)
            return Rows(C=C, d=d, s=s_, z=z, A=A, constant=self.constant)
        c, d = taken(n), next(left)
        if self.kind == "linear":
            return Linear(c=c, d=jnp.asarray(d, dtype), z=z, A=A)
        drift = None if isinstance(d, float) and d == 0 else jnp.asarray(d, dtype)
        honest = A is not None
        return Rate(c=c, s=s[0], z=z, d=drift, A=A, constant=self.constant, honest=honest)


class Parts:
    """The terms of a closure, as nodes of its graph."""

    def __init__(self, lowered: Lowered, closure: Closure, algebra: Sampled) -> None:
        self.lowered = lowered
        self.closure = closure
        self.algebra = algebra
        self.typical = lowered.sampled(0, drawn="branches")
        self.nodes = Nodes(lowered.graph)
        n = len(closure.basis)
        self.A, self.z = [], []
        for b in closure.basis:
            rate = self._derivative(b)
            self.A.append([self._kept(rate, m) for m in closure.pivots])
            self.z.append(self._kept(rate, ()))
        self.rows = []
        polynomials = {(kind, k): p for kind, k, p in lowered.rows}
        for row in closure.rows:
            p = polynomials[row.kind, row.index]
            assert not isinstance(p, Top)
            c = [self._kept(p, m) for m in closure.pivots]
            constant = self._kept(p, ())
            self.rows.append((row, c, self.negative(constant)))
        self.size = n

    def _derivative(self, b: Constant) -> dict[Monomial, int]:
        p = {m: self.nodes.number(c) for m, c in b.items()}
        rate = lie(self.lowered.ring, self.nodes, p, self.lowered.rates)
        assert not isinstance(rate, Top)
        return rate

    def _kept(self, p: dict[Monomial, int], monomial: Monomial) -> int:
        """A coefficient, zero where it cancels at every point."""
        node = p.get(monomial)
        if node is None:
            return self.lowered.graph.zero
        value, size = self.algebra.of(node)
        if np.all(np.abs(value) <= CANCELLED * size):
            return self.lowered.graph.zero
        return node

    def negative(self, node: int) -> int:
        graph = self.lowered.graph
        return graph.zero if graph.value(node) == 0 else graph.op("neg", node)

    def is_zero(self, node: int) -> bool:
        return bool(self.lowered.graph.value(node) == 0)

    def is_constant(self, nodes: Sequence[int]) -> bool:
        """Whether none of them depends on u or y."""
        found = (self.lowered.graph.inputs(n) for n in nodes)
        return not any(kind != "p" for each in found for kind, _ in each)

    def state_matrix(self) -> np.ndarray:
        """A at points as they may be, shape `(N, n, n)`."""
        self.typical.look(sorted({n for row in self.A for n in row}))
        A = [[self.typical.of(c)[0] for c in row] for row in self.A]
        size = self.typical.points.size
        full = [[np.broadcast_to(c, size) for c in row] for row in A]
        return np.moveaxis(np.array(full), -1, 0)


def quadratic(parts: Parts) -> tuple[list[int], int] | None:
    """Whether the relation is one quadratic one of the linear entries of the basis: these,
    and the place of the quadratic one."""
    closure = parts.closure
    degrees = [max(map(len, b)) for b in closure.basis]
    states = parts.lowered.ring.states
    plain = all(g < states for b in closure.basis for m in b for g in m)
    if not plain or sorted(degrees)[-1:] != [2] or degrees.count(2) != 1:
        return None
    if len(closure.rows) != 1 or closure.rows[0].kind != "equation":
        return None
    q = degrees.index(2)
    linear = [k for k in range(len(degrees)) if k != q]
    own = {m for k in linear for m in closure.basis[k]}
    squares = {(g,) for m in closure.basis[q] for g in m}
    alone = all(len(closure.basis[k]) == 1 for k in linear)
    if not alone or any(len(m) != 2 for m in closure.basis[q]) or not squares <= own:
        return None
    inner = [parts.A[k][j] for k in linear for j in (*linear, q)]
    return (linear, q) if all(map(parts.is_zero, inner)) else None


def relation_of(parts: Parts, free: bool) -> tuple[DerivedRelation, list[Constant]]:
    """The relation of the terms, and what the entries of its x are; unless its parameters
    are `free`, they are fixed."""
    graph, model = parts.lowered.graph, parts.lowered.model
    found = quadratic(parts)
    outputs: tuple[int, ...] = ()
    constant = False
    basis = list(parts.closure.basis)
    if found is not None:
        kind, roots, size = "quadratic", _quadratic(parts, *found), len(found[0])
        basis = [basis[k] for k in found[0]]
    else:
        size = parts.size
        every = [n for row in parts.A for n in row]
        moving = not all(map(parts.is_zero, every))
        rates = [row for row in parts.rows if row[0].kind == "rate"]
        others = [row for row in parts.rows if row[0].kind != "rate"]
        outputs = tuple(row.index for row, *_ in rates)
        constant = parts.is_constant([*every, *(n for _, c, _ in parts.rows for n in c)])
        one = len(parts.rows) == 1 and (constant or not moving)
        head = [*parts.z, graph.const(float(moving), float), *(every if moving else [])]
        if one and (rates or not any(_has_input(parts, row) for row in others)):
            ((_, c, d),) = parts.rows
            kind = "rate" if rates else "linear"
            roots = [*head, *c, d]
        else:
            kind = "rows"
            roots = [*head, *_several(parts, rates, others)]
    p = {k: jnp.asarray(v, float) for k, v in model.known.items()}
    relation = DerivedRelation(
        p if free else {},
        kind,
        program(graph, roots),
        size,
        (len(model.inputs), len(model.outputs)),
        outputs,
        constant,
        () if free else tuple(model.known.values()),
    )
    return relation, basis


def _has_input(parts: Parts, row: Any) -> bool:
    _, c, d = row
    inputs = (parts.lowered.graph.inputs(n) for n in (*c, d))
    return any(kind == "u" for each in inputs for kind, _ in each)


def _several(parts: Parts, rates: list[Any], others: list[Any]) -> Entries:
    """Rows times their weights: one over the range of the output, or over the size of the
    equation, so that they are of one size."""
    graph, nodes = parts.lowered.graph, parts.nodes
    ranges = list(parts.lowered.model.outputs.values())
    weights = [1.0 / (ranges[row.index][1] - ranges[row.index][0]) for row, *_ in rates]
    for _, c, d in others:
        sizes = [np.abs(parts.typical.of(n)[0]).mean() for n in (*c, d)]
        weights.append(1.0 / max(sizes))
    if len(weights) == 1:
        weights = [1.0]
    rows = [*rates, *others]
    scaled = [
        [nodes.times(graph.const(w, float), n) for n in (*c, d)]
        for w, (_, c, d) in zip(weights, rows, strict=True)
    ]
    C = [n for row in scaled for n in row[:-1]]
    d = [row[-1] for row in scaled]
    kept = [graph.const(w, float) for w in weights[: len(rates)]]
    return [graph.const(float(len(rows)), float), *C, *d, *kept]


def _quadratic(parts: Parts, linear: list[int], q: int) -> Entries:
    """The terms of `1/2 x'Q x = c'x + d`, the row divided by the factor of its square."""
    graph = parts.lowered.graph
    places = [parts.closure.pivots[k][0] for k in linear]
    n = len(linear)
    Q = np.zeros((n, n))
    for (i, j), value in parts.closure.basis[q].items():
        i, j = places.index(i), places.index(j)
        Q[i, j] += value
        Q[j, i] += value
    ((_, c, d),) = parts.rows
    factor = c[q]

    def divided(node: int) -> int:
        return graph.zero if parts.is_zero(node) else graph.op("div", node, factor)

    number = lambda x: graph.const(float(x), float)
    is_round = bool(np.array_equal(Q, Q[0, 0] * np.eye(n)))
    return [
        *(parts.z[k] for k in linear),
        number(False),
        number(is_round),
        *([number(Q[0, 0])] if is_round else [number(x) for x in Q.ravel()]),
        *(divided(parts.negative(c[k])) for k in linear),
        divided(d),
    ]
