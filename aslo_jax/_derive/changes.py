"""Changes of coordinates that remove products of states: integrating factors.

Where every product in the rate of a state has that state as a factor, and the other one is
a rate of what is measured, `x' = x F(y)'y' + ...` loses them in `mu x`, with
`mu' = -mu F'y'` (the integrating factors of the paper's Props 4 and 5).
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

from .dictionary import Matrix, with_slopes
from .lifted import Lowered
from .model import Model, entries, wants_parameters
from .polynomials import Points, Top
from .symbols import Program, program

DEGREE = 200  # the most of a factor's series
TAIL = 1e-14  # of a series, what is left out
MARGIN = 1.25  # ranges of an output, about their middle, for which a factor is known
SAME = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """`ln mu = k'y + a ln N(y) + C(y_j)`: N a function that the model has, by its `code`,
    to the `power` a; C a Chebyshev series about the `middle` of the output `place` for
    values within `half` of it, and no number beyond."""

    slopes: tuple[float, ...]
    code: Program | None = None
    power: float = 1.0
    place: int = 0
    series: tuple[float, ...] = ()
    middle: float = 0.0
    half: float = 1.0

    @property
    def symbolic(self) -> bool:
        """Whether it holds for other parameters too."""
        return not (self.series or any(self.slopes))

    def __call__(self, y: Float[Array, " p"], p: Sequence[Any]) -> Float[Array, ""]:
        return _factor_at(self, y, tuple(p))


@functools.partial(jax.jit, static_argnums=0)  # traced once, and not at every use
def _factor_at(
    factor: Factor, y: Float[Array, " p"], p: tuple[Any, ...]
) -> Float[Array, ""]:
    total = sum(
        (k * y[j] for j, k in enumerate(factor.slopes) if k),
        start=jnp.zeros((), y.dtype),
    )
    if factor.code is not None:
        (value,) = factor.code({"y": y, "p": p})
        product = _powered(jnp.asarray(value, y.dtype), factor.power)
        return product if factor.symbolic else product * jnp.exp(total)
    if factor.series:
        s = (y[factor.place] - factor.middle) / factor.half
        s = jnp.cos(jnp.arccos(s))  # itself, and no number beyond one
        later, latest = 0.0, 0.0
        for c in factor.series[:0:-1]:
            later, latest = c + 2.0 * s * later - latest, later
        total = total + factor.series[0] + s * later - latest
    return jnp.exp(total)


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """The states times their `factors`, `None` for one; p are the parameters that are
    known."""

    factors: tuple[Factor | None, ...]

    @property
    def symbolic(self) -> bool:
        """Whether it holds for other parameters too."""
        return all(f is None or f.symbolic for f in self.factors)

    def __call__(self, y: Float[Array, " p"], p: Sequence[Any]) -> Float[Array, " n"]:
        one = jnp.ones((), y.dtype)
        return jnp.stack([one if f is None else f(y, p) for f in self.factors])

    def into(
        self, x: Float[Array, " n"], y: Float[Array, " p"], p: Sequence[Any]
    ) -> Float[Array, " n"]:
        """The new coordinates of states `x`."""
        return x * self(y, p)

    def back(
        self, x: Float[Array, " n"], y: Float[Array, " p"], p: Sequence[Any]
    ) -> Float[Array, " n"]:
        """The states of new coordinates `x`."""
        return x / self(y, p)


def changed(model: Model, change: "Change | Matrix") -> Model:
    """The model in the new coordinates."""
    n, unknown = len(model.states), jnp.zeros(len(model.unknown))

    def known(p: Any) -> tuple[Any, ...]:
        return tuple(p[name] for name in model.known)

    def back(x: Array, y: Array, p: Any) -> Array:
        return change.back(jnp.concatenate([x, unknown]), y, known(p))[:n]

    def into(x: Array, y: Array, p: Any) -> Array:
        return change.into(jnp.concatenate([x, unknown]), y, known(p))[:n]

    def f(x: Array, y: Array, u: Array, p: Any) -> Array:
        before = back(x, y, p)
        rates = jnp.stack(entries(_called(model.f, before, y, u, p)))
        speeds = jnp.stack(entries(_called(model.g, before, y, u, p)))
        _, slope = jax.jvp(lambda y: into(before, y, p), (y,), (speeds,))
        return into(rates, y, p) + slope

    def g(x: Array, y: Array, u: Array, p: Any) -> Any:
        return _called(model.g, back(x, y, p), y, u, p)

    def h(x: Array, y: Array, u: Array, p: Any) -> Any:
        return _called(model.h, back(x, y, p), y, u, p)

    return dataclasses.replace(model, f=f, g=g, h=None if model.h is None else h)


def _called(function: Any, x: Any, y: Any, u: Any, p: Any) -> Any:
    return function(x, y, u, p) if wants_parameters(function) else function(x, y, u)


def integrating(lowered: Lowered) -> Change | None:
    """The factors that remove products from the rates of states, `None` without any."""
    model = lowered.model
    rows = {k: p for kind, k, p in lowered.rows if kind == "rate"}
    if len(rows) < len(model.outputs) or any(isinstance(p, Top) for p in rows.values()):
        return None
    found: list[Factor | None] = []
    for i, rate in enumerate(lowered.rates):
        products = [] if isinstance(rate, Top) else [m for m in rate if len(m) > 1]
        own = any(len(m) == 2 and i in m for m in products)
        found.append(_factor(lowered, i, rows) if own else None)
    return Change(tuple(found)) if any(found) else None


def _factor(lowered: Lowered, i: int, rows: dict[int, Any]) -> Factor | None:
    field = _field(lowered, i, rows)
    scattered = field(lowered.sampled(3).points.inputs)
    if scattered is None:
        return None
    size = np.abs(scattered).max(initial=1e-300)
    varying = np.flatnonzero(np.ptp(scattered, axis=0) > SAME * size)
    slopes = np.where(np.abs(scattered[0]) > SAME * size, scattered[0], 0.0)  # no rounding
    slopes[varying] = 0.0
    constants = tuple(float(k) for k in slopes)
    if not varying.size:
        return Factor(constants)
    own = _own_factor(lowered, scattered)
    if own is not None:
        return own
    if varying.size > 1:
        return None
    j = int(varying[0])
    inputs = dict(lowered.sampled(3).points.inputs)
    now = inputs["y", j]
    series = _series(lowered, field, j)
    if series is None:
        return None
    low, high = list(lowered.model.outputs.values())[j]
    middle, half = 0.5 * (low + high), 0.5 * MARGIN * (high - low)
    slope = chebyshev.chebval((now - middle) / half, chebyshev.chebder(series)) / half
    if np.abs(slope - scattered[:, j]).max() > SAME * size:
        return None  # it depends on other signals, too
    return Factor(
        constants, place=j, series=tuple(map(float, series)), middle=middle, half=half
    )


def _own_factor(lowered: Lowered, field: np.ndarray) -> Factor | None:
    """The factor whose gradient of the logarithm is `field` at the points, as a power of a
    function of y that the model has: of what it divides by, such as an inertia."""
    graph, points = lowered.graph, lowered.sampled(3).points
    points.good[:] = True
    divisors = {n.args[1] for n in graph.nodes if n.op == "div"}
    inside = lambda number: {kind for kind, _ in graph.inputs(number)}
    of_y = [n for n in sorted(divisors) if "y" in inside(n) <= {"y", "p"}]
    of_y = list(dict.fromkeys(n for n in _decided(lowered, points, of_y) if inside(n)))
    if not of_y:
        return None
    p = tuple(float(v) for v in lowered.model.values())
    code = program(graph, of_y)
    values, slopes = with_slopes(code, p, points, field.shape[1])
    size = np.abs(field).max()
    for k in sorted(range(len(of_y)), key=lambda k: len(graph.reachable([of_y[k]]))):
        gradient = slopes[:, k] / values[:, k, None]
        if not (np.isfinite(gradient).all() and np.all(values[:, k] > 0)):
            continue
        # And constant slopes besides, as of friction that is linear in the rates.
        one = np.broadcast_to(np.eye(field.shape[1]), (*field.shape, field.shape[1]))
        M = np.concatenate([gradient[..., None], one], axis=2).reshape(field.size, -1)
        solved, *_ = np.linalg.lstsq(M, field.ravel(), rcond=None)
        if np.abs(M @ solved - field.ravel()).max() > SAME * size:
            continue
        power, rest = round(float(solved[0]), 9), np.round(solved[1:] / size, 9) * size
        return Factor(tuple(map(float, rest)), program(graph, [of_y[k]]), power)
    return None


def _decided(lowered: Lowered, points: Points, nodes: list[int]) -> list[int]:
    """Nodes with the branches that all points take; those that have others are left out."""
    graph, done = lowered.graph, {}
    there = Points(points.inputs, 0, "nothing")

    def made(number: int) -> int | None:
        node = graph.nodes[number]
        if node.op == "select":
            which, _ = there.of(graph, [node.args[0]])[0]
            if which.all() or not which.any():
                return done[node.args[1] if which.all() else node.args[2]]
            return None
        args = [done[a] for a in node.args]
        if not args or any(a is None for a in args):
            return None if args else number
        return graph.made(node, tuple(args))

    for number in graph.reachable(nodes):
        done[number] = made(number)
    return [done[n] for n in nodes if done[n] is not None]


def _powered(x: Array, power: float) -> Array:
    if power in (1.0, -1.0, 2.0, -2.0):
        found = x if abs(power) == 1.0 else x * x
        return found if power > 0 else 1.0 / found
    if abs(power) == 0.5:
        return jnp.sqrt(x) if power > 0 else 1.0 / jnp.sqrt(x)
    return jnp.exp(power * jnp.log(x))


def _field(
    lowered: Lowered, i: int, rows: dict[int, Any]
) -> Callable[[dict[Any, np.ndarray]], np.ndarray | None]:
    """The gradient of ln mu at points, shape `(N, p)`; `None` where there is none."""
    graph, zero = lowered.graph, lowered.graph.zero
    rate = lowered.rates[i]
    assert not isinstance(rate, Top)
    n = lowered.ring.states
    gamma = [rate.get((min(i, k), max(i, k)), zero) for k in range(n)]
    G = [[rows[j].get((k,), zero) for k in range(n)] for j in sorted(rows)]
    nodes = [*gamma, *(c for row in G for c in row)]

    def field(inputs: dict[Any, np.ndarray]) -> np.ndarray | None:
        points = Points(inputs, 0, "nothing")
        values = np.stack([v[0] for v in points.of(graph, nodes)], axis=1)
        left, right = values[:, :n], values[:, n:].reshape(len(values), -1, n)
        found = np.stack(
            [
                np.linalg.lstsq(a.T, -b, rcond=None)[0]
                for a, b in zip(right, left, strict=True)
            ]
        )
        rest = np.einsum("nji,nj->ni", right, found) + left
        size = np.abs(left).max(initial=1e-300)
        good = np.isfinite(found).all() and np.abs(rest).max() < SAME * size
        return found if good else None

    return field


def _series(lowered: Lowered, field: Any, j: int) -> np.ndarray | None:
    """The Chebyshev series of the integral of the field along the output `j`."""
    low, high = list(lowered.model.outputs.values())[j]
    middle, half = 0.5 * (low + high), 0.5 * MARGIN * (high - low)
    nodes = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    inputs = {
        slot: np.full(nodes.size, np.median(x))
        for slot, x in lowered.sampled(3).points.inputs.items()
    }
    inputs["y", j] = middle + half * nodes
    values = field(inputs)
    if values is None:
        return None
    # At these nodes the polynomials are orthogonal.
    angles = np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1)
    fit = np.cos(np.outer(np.arange(DEGREE + 1), angles)) @ values[:, j]
    fit *= 2.0 / (DEGREE + 1)
    fit[0] *= 0.5
    series = chebyshev.chebint(fit) * half
    largest = np.abs(series).max(initial=1e-300)
    kept = np.flatnonzero(np.abs(series) > TAIL * largest)
    return series[: kept[-1] + 1] if kept.size and kept[-1] < DEGREE else None
