"""The Kalman filter of a lifted relation in continuous time."""

from typing import Any

import jax.numpy as jnp

from .._factored import (
    Rows,
    divided,
    dot,
    less,
    packed,
    plus,
    product,
    reciprocal,
    stacked,
    times,
    transposed_times,
    unit_inverse,
)
from .._relations import Quadratic, Rate
from ._lifted_belief import LiftedBelief, lists_of
from ._lifting import (
    Sensitivity,
    added,
    blurred,
    entries,
    has_moved,
    matrix,
    measurement_of,
    quadratic,
    scaled,
    squares,
    total,
    trace,
)


def flow(rows: tuple[Any, ...], noise: Any, interval: Any, X: LiftedBelief) -> LiftedBelief:
    """The derivative of the belief, with the terms of its rows and their noise:
    `P' = F P + P F' + W - K V K'` in the factors of P, since `U^-1 P' U^-T` has d' on its
    diagonal and `U^-1 U' D` above it."""
    lists = lists_of(X)
    r, size, dtype = lists.r, len(lists.mean), rows[0].z.dtype
    x, P, z = lists.x, lists.spread(), entries(rows[0].z)
    # Without an interval there is no answer, and none that looks like one.
    h = jnp.asarray(jnp.nan if interval is None else interval, dtype)
    F: Rows = [[0] * size for _ in range(size)]
    if rows[0].A is not None:
        F[r:] = [[0] * r + row for row in matrix(rows[0].A)]
    bias: list[Any] = [0] * r + z
    own: list[Any] = [0] * size
    inputs, outputs = scaled(noise.z_by_u, -1.0), scaled(noise.z_by_y, -1.0)
    above_u: Rows = []
    above_y: Rows = []
    loose: Rows = []  # the noise of each row in one sample
    columns = lambda A: list(zip(*A, strict=True))
    every = list(zip(rows, added(rows), noise.rows, noise.rows_by_u, strict=True))

    def entering(s: Sensitivity) -> list[Any]:
        slopes = [dot(list(c), x) for c in columns(s.c)]
        return [less(a, b) for a, b in zip(s.d, slopes, strict=True)]

    for row, k, s, s_by_u in every:
        if k is None:
            continue
        if isinstance(row, Quadratic):
            Q = quadratic(row, len(x))
            F[k][r:] = [dot(q, z) for q in Q]
            gradient = [dot(q, x) for q in Q]
            above_u.append([dot(gradient, list(c)) for c in columns(inputs)])
            above_y.append([dot(gradient, list(c)) for c in columns(outputs)])
            scatter = product(product(Q, noise.z()), Q)
        else:
            assert isinstance(row, Rate)
            F[k][r:] = entries(row.c)
            bias[k] = 0 if row.d is None else -row.d
            above_u.append(entering(s_by_u))
            above_y.append(entering(s))
            scatter = total(s.regressors(), s_by_u.regressors())
        own[k] = times(h, trace(scatter, P))
        loose.append(scaled(scatter, h * h))
    by_u, by_y = above_u + inputs, above_y + outputs
    rate = [plus(dot(F[i], lists.mean), bias[i]) for i in range(size)]
    inverse = unit_inverse(lists.U)
    FU = product(inverse, product(F, lists.U))
    W = scaled(squares([a + b for a, b in zip(by_u, by_y, strict=True)]), h)
    for i in range(size):
        W[i][i] = plus(W[i][i], own[i])
    G = product(inverse, product(W, [list(c) for c in columns(inverse)]))
    M: Rows = [
        [
            plus(plus(times(FU[i][j], lists.d[j]), times(FU[j][i], lists.d[i])), G[i][j])
            for j in range(size)
        ]
        for i in range(size)
    ]
    unsteady = [jnp.ones((), dtype) / h] * r
    for row, k, s, s_by_u in every:
        m = measurement_of(row, s, s_by_u, x)
        V = times(h, plus(plus(dot(m.J, m.J), m.by_u), blurred(m, P)))
        line = [m.sign if i == k else 0 for i in range(r)] + m.h
        f = transposed_times(lists.U, line)
        gathered = None if k is None else scaled(loose[k], lists.unsteady[k])
        moved = has_moved(m, lists.d[r:], f[r:], P, gathered)
        f[r:] = [jnp.where(moved, e, 0.0) for e in f[r:]]
        shared = divided(lists.U, [times(h, dot(e, m.J)) for e in by_y])
        b = [plus(times(p, q), e) for p, q, e in zip(lists.d, f, shared, strict=True)]
        pull = (m.value - dot(line, lists.mean)) / V
        rate = [plus(a, times(dot(e, b), pull)) for a, e in zip(rate, lists.U, strict=True)]
        if m.common is not None:
            weight = jnp.where(moved, -h / (V * h), 0.0)
            g = transposed_times(lists.U, [0] * r + [times(weight, e) for e in m.common])
            g = [times(p, q) for p, q in zip(lists.d, g, strict=True)]
            rate = [plus(a, dot(e, g)) for a, e in zip(rate, lists.U, strict=True)]
        M = [
            [less(M[i][j], times(b[i], b[j]) / V) for j in range(size)] for i in range(size)
        ]
        if k is not None:
            share = jnp.where(moved, times(b[k], f[k]) / V, 0.0)
            unsteady[k] = unsteady[k] - 2.0 * share * lists.unsteady[k]
    slopes = [
        [times(M[i][j], reciprocal(lists.d[j])) if i < j else 0 for j in range(size)]
        for i in range(size)
    ]
    factors = packed(product(lists.U, slopes), [M[i][i] for i in range(size)], dtype)
    return LiftedBelief(stacked(rate, dtype), factors, stacked(unsteady, dtype))
