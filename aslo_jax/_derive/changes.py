"""Changes of coordinates that remove products of states: integrating factors.

Where every product in the rate of a state has that state as a factor, and the other one is
a rate of what is measured, `x' = x F(y)'y' + ...` loses them in `mu x`, with
`mu' = -mu F'y'` (the integrating factors of the paper's Props 4 and 5).
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

from .dictionary import Matrix
from .lifted import Lowered
from .model import Model, entries, wants_parameters
from .polynomials import Points, Top

DEGREE = 200  # the most of a factor's series
TAIL = 1e-14  # of a series, what is left out
MARGIN = 1.25  # ranges of an output, about their middle, for which a factor is known
SAME = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """`ln mu = k'y + C(y_j)`, C a Chebyshev series about the `middle` of the output `place`
    for values within `half` of it, and no number beyond."""

    slopes: tuple[float, ...]
    place: int = 0
    series: tuple[float, ...] = ()
    middle: float = 0.0
    half: float = 1.0

    def __call__(self, y: Float[Array, " p"]) -> Float[Array, ""]:
        total = sum(
            (k * y[j] for j, k in enumerate(self.slopes) if k),
            start=jnp.zeros((), y.dtype),
        )
        if self.series:
            s = (y[self.place] - self.middle) / self.half
            s = jnp.where(jnp.abs(s) <= 1.0, s, jnp.nan)
            later, latest = 0.0, 0.0
            for c in self.series[:0:-1]:
                later, latest = c + 2.0 * s * later - latest, later
            total = total + self.series[0] + s * later - latest
        return jnp.exp(total)


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """The states times their `factors`, `None` for one."""

    factors: tuple[Factor | None, ...]

    def __call__(self, y: Float[Array, " p"]) -> Float[Array, " n"]:
        one = jnp.ones((), y.dtype)
        return jnp.stack([one if f is None else f(y) for f in self.factors])

    def into(self, x: Float[Array, " n"], y: Float[Array, " p"]) -> Float[Array, " n"]:
        """The new coordinates of states `x`."""
        return x * self(y)

    def back(self, x: Float[Array, " n"], y: Float[Array, " p"]) -> Float[Array, " n"]:
        """The states of new coordinates `x`."""
        return x / self(y)


def changed(model: Model, change: "Change | Matrix") -> Model:
    """The model in the new coordinates."""
    n, unknown = len(model.states), jnp.zeros(len(model.unknown))

    def back(x: Array, y: Array) -> Array:
        return change.back(jnp.concatenate([x, unknown]), y)[:n]

    def into(x: Array, y: Array) -> Array:
        return change.into(jnp.concatenate([x, unknown]), y)[:n]

    def f(x: Array, y: Array, u: Array, p: Any) -> Array:
        before = back(x, y)
        rates = jnp.stack(entries(_called(model.f, before, y, u, p)))
        speeds = jnp.stack(entries(_called(model.g, before, y, u, p)))
        _, slope = jax.jvp(lambda y: into(before, y), (y,), (speeds,))
        return into(rates, y) + slope

    def g(x: Array, y: Array, u: Array, p: Any) -> Any:
        return _called(model.g, back(x, y), y, u, p)

    def h(x: Array, y: Array, u: Array, p: Any) -> Any:
        return _called(model.h, back(x, y), y, u, p)

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
        own = products and all(len(m) == 2 and i in m for m in products)
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
    return Factor(constants, j, tuple(map(float, series)), middle, half)


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
        points = Points(inputs, 0, True)
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
    series = chebyshev.chebint(chebyshev.chebfit(nodes, values[:, j], DEGREE)) * half
    largest = np.abs(series).max(initial=1e-300)
    kept = np.flatnonzero(np.abs(series) > TAIL * largest)
    return series[: kept[-1] + 1] if kept.size and kept[-1] < DEGREE else None
