"""Random models, and what is left of the equations of a relation derived from one."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from aslo_jax._derive.decoding import lifted_states
from aslo_jax.derivation import Derived, Model

TABLE = jnp.array([-1.0, 0.0, 2.0]), jnp.array([0.3, 1.0, 2.5])


class Drawn:
    """Expressions in x, y, u and p, as functions of these."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def number(self) -> float:
        return float(np.round(self.rng.uniform(-2, 2), 2)) or 0.5

    def measured(self, depth: int) -> Callable:
        """In what is measured, of any kind: with steps, tables, rare branches."""
        k, c, which = int(self.rng.integers(4)), self.number(), self.rng.random()
        if depth == 0 or which < 0.35:
            return [
                lambda x, y, u, p: y[k % len(y)],
                lambda x, y, u, p: u[0],
                lambda x, y, u, p: c,
                lambda x, y, u, p: p["a"],
            ][int(self.rng.integers(4))]
        a, b = self.measured(depth - 1), self.measured(depth - 1)
        return [
            lambda *s: a(*s) + b(*s),
            lambda *s: a(*s) * b(*s),
            lambda *s: jnp.sin(a(*s)),
            lambda *s: jnp.exp(0.3 * jnp.tanh(a(*s))),
            lambda *s: jnp.where(a(*s) > c, a(*s), b(*s)),
            lambda *s: a(*s) / (1.5 + jnp.cos(b(*s))),
            lambda *s: jnp.interp(a(*s), *TABLE),
            lambda *s: jnp.floor(a(*s)),
            lambda *s: jnp.maximum(a(*s) - 0.95, 0.0),
            lambda *s: jnp.sqrt(1.0 + a(*s) ** 2),
        ][int(self.rng.integers(10))]

    def of_states(self, depth: int) -> Callable:
        """In the states too, now and then with what is no polynomial."""
        k, c, which = int(self.rng.integers(4)), self.number(), self.rng.random()
        if depth == 0 or which < 0.3:
            return lambda x, y, u, p: x[k % len(x)]
        a, b, m = self.of_states(depth - 1), self.of_states(depth - 1), self.measured(1)

        def solved(*s: Any) -> Any:
            M = jnp.array([[2.0, 0.3], [0.1, 1.5]]).at[0, 1].set(0.3 * jnp.cos(m(*s)))
            return jnp.linalg.solve(M, jnp.stack([a(*s), s[0][-1]]))[k % 2]

        return [
            lambda *s: a(*s) + b(*s),
            lambda *s: m(*s) * a(*s),
            lambda *s: m(*s) + a(*s),
            lambda *s: a(*s) * b(*s),
            lambda *s: jnp.sin(c * a(*s)),
            lambda *s: jnp.cos(a(*s) + m(*s)),
            lambda *s: jnp.exp(0.5 * c * a(*s)),
            lambda *s: jnp.where(m(*s) > c, a(*s), b(*s)),
            solved,
            lambda *s: jax.lax.fori_loop(0, 3, lambda k, z: z + 0.3 * a(*s), 0.0),
            lambda *s: (a(*s) + b(*s)) ** 2 - a(*s) ** 2 - b(*s) ** 2,
            lambda *s: a(*s) + 1e-11 * a(*s) ** 2,
            lambda *s: jnp.where(a(*s) > 30.0, a(*s) ** 2, a(*s)),
            lambda *s: jnp.clip(a(*s), -40.0, 40.0),
            lambda *s: jnp.floor(a(*s)),
            lambda *s: jnp.abs(a(*s)),
        ][int(self.rng.integers(16))]


def model_of(seed: int) -> Model:
    """A model of up to three states and two outputs."""
    drawn = Drawn(seed)
    n, p = (int(drawn.rng.integers(1, high)) for high in (4, 3))

    def rate(depth: int) -> Callable:
        parts = drawn.measured(1), drawn.of_states(depth), drawn.measured(2)
        scale, part, free = parts
        real = lambda x: jnp.asarray(x, float)
        return lambda *s: real(scale(*s)) * real(part(*s)) + real(free(*s))

    f = [rate(int(drawn.rng.choice([0, 0, 0, 1]))) for _ in range(n)]
    g = [rate(int(drawn.rng.choice([0, 1, 1, 2]))) for _ in range(p)]
    return Model(
        lambda x, y, u, p: [each(x, y, u, p) for each in f],
        lambda x, y, u, p: [each(x, y, u, p) for each in g],
        states={f"x{k}": (-1.0 + 0.2 * k, 1.5) for k in range(n)},
        outputs={f"y{k}": (-1.0, 1.2) for k in range(p)},
        inputs={"u": (-1.0, 1.3)},
        parameters={"a": 0.7},
    )


def left_of(found: Derived, wide: float = 1.0) -> float:
    """The most that is left, relative, of `X' = A X + z` and of the rows at random points
    of the ranges, or of ranges as `wide`: X' along the model by a complex step, which has
    no error of its own."""
    model, rng, N = found.model, np.random.default_rng(0), 64

    def drawn(ranges: Any) -> np.ndarray:
        low, high = np.array(list(ranges.values()), float).T
        s = wide * rng.uniform(-1, 1, (N, len(low)))
        return 0.5 * (low + high) + 0.5 * (high - low) * s

    x, y, u = (drawn(r) for r in (model.ranges, model.outputs, model.inputs))
    p, change = jnp.asarray(model.values()), found.coordinates.change
    into = lambda x, y: x if change is None else change.into(x, y, found.relation.values)

    @jax.jit
    @jax.vmap
    def at(x: Any, y: Any, u: Any) -> Any:
        f = jnp.stack(model.rates(x, y, u, p))
        g = jnp.stack(list(model.measured_rates(x, y, u, p).values()))
        return g, *jax.jvp(into, (x, y), (f, g)), found.relation(u, y)

    g, x, dx, terms = at(x, y, u)
    step = 1e-30
    moved = np.asarray(x) + 1j * step * np.asarray(dx)
    X = lifted_states(found._ring, found._basis, moved, model.values())
    X, dX = np.real(X), np.imag(X) / step
    parts = [np.asarray(terms.z)]
    if terms.A is not None:
        parts += list(np.moveaxis(np.asarray(terms.A) * X[:, None, :], -1, 0))
    size = np.sum(np.abs(parts), axis=0) + np.abs(dX) + 1e-7 * (1 + np.abs(dX).max())
    left = [np.abs(np.sum(parts, axis=0) - dX) / size]
    several = found.relation.kind == "rows"
    C = np.asarray(terms.C if several else terms.c).reshape(N, -1, X.shape[1])
    d = np.zeros((N, 1)) if terms.d is None else np.asarray(terms.d).reshape(N, -1)
    outputs = list(found.relation.rates)
    s = np.asarray(terms.s).reshape(N, -1)
    rates = s / y[:, outputs] * np.asarray(g)[:, outputs]
    size = np.sum(np.abs(C * X[:, None]), axis=2) + np.abs(d) + np.abs(rates) + 1e-9
    left.append(np.abs(np.sum(C * X[:, None], axis=2) - d - rates) / size)
    whole = np.concatenate(left, axis=1)
    return float(whole[np.isfinite(whole).all(axis=1)].max(initial=0.0))
