"""The passes of a search along its log: the filter, and the white errors with their slopes.

Both run in the fused engine, where that can compile them, in a tenth of the time that XLA
takes: a step of either is some hundred operations on a handful of numbers. Slopes are
carried along, one direction in each lane.
"""

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._frontend.lower import NotFusible
from .imperfections import Sight
from .kept import run_kept
from .problem import Problem, predicted
from .whiten import (
    Gains,
    Noise,
    Signals,
    error_first,
    error_step,
    errors,
    filter_first,
    filter_step,
    kalman,
    rows_of,
)

if TYPE_CHECKING:
    from ...engines._fused.program import Bodies


class Filtered(NamedTuple):
    """Of one pass of the filter: the negative log-likelihood per row, its slope in the
    levels of the noise, the gains, and the half logarithm of the variance of all errors."""

    cost: float
    slope: Float[np.ndarray, "2"]
    gains: Gains
    size: float


class Passes:
    """The passes of a `problem`, with noise of given levels over `drift`, the size of the
    derivatives (their units), and `reference`, a rough guess of that of the outputs."""

    def __init__(
        self,
        problem: Problem,
        drift: Float[np.ndarray, " w"],
        reference: Float[np.ndarray, " p"],
    ) -> None:
        self.problem, self.drift, self.reference = problem, drift, reference
        self.fused = importlib.util.find_spec("llvmlite") is not None
        self._seen = Sight(problem.parameters, problem.signals)
        self._there: tuple[Any, Any] = None, None
        arrays, rest = eqx.partition(
            (problem.parameters, problem.form), lambda x: isinstance(x, Array | np.ndarray)
        )
        self._leaves, tree = jax.tree.flatten(arrays)

        def prediction(leaves, v):
            parameters, form = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
            return predicted(parameters, form, problem.states, v)[:2]

        self._prediction = prediction
        self._key = rest, tree, problem.states

    def noise(self, levels: Float[np.ndarray, "2"]) -> Noise:
        """The noise of `levels`."""
        return noise_of(levels, self.drift, self.reference)

    def filtered(
        self, v: Float[np.ndarray, " v"], levels: Float[np.ndarray, "2"]
    ) -> Filtered:
        """The filter with the unknowns `v` and the noise of `levels`."""
        if self.fused:
            try:
                return self._fused_filter(v, levels)
            except NotFusible:
                self.fused = False
        found = _filter(self.problem, v, levels, self.drift, self.reference)
        cost, slope, gains, size = found
        return Filtered(float(cost), np.asarray(slope), gains, float(size))

    def whitened(
        self, v: Float[np.ndarray, " v"], gains: Gains
    ) -> tuple[Float[np.ndarray, "N g"], Float[np.ndarray, "N g v"]]:
        """The white errors with the unknowns `v` and frozen gains, and their slopes in the
        unknowns."""
        if self.fused:
            try:
                return self._fused_errors(v, gains)
            except NotFusible:
                self.fused = False
        e, J = _whitened(self.problem, v, self.reference, gains)
        return np.asarray(e), np.asarray(J)

    def _signals(self, v: Float[np.ndarray, " v"]) -> tuple[Any, Any]:
        """The first sample and all rows, and their slopes in `v`, of which a leading axis
        counts; kept while the errors of the record stay as they are."""
        seen = self._seen(v[: len(self.problem.parameters.names)])
        if self._there[0] is not seen:
            self._there = seen, _rows(seen, v.size)
        return self._there[1]

    def _fused_filter(self, v, levels) -> Filtered:
        (first, rows), _ = self._signals(v)
        inputs = {
            "shared": (
                self._leaves,
                np.asarray(v, float),
                np.asarray(levels, float),
                np.asarray(self.drift),
                np.asarray(self.reference),
                first,
            ),
            "log": rows,
            "lane": np.eye(2),
        }
        found, (costs, slopes) = self._run("filter", self._filter_bodies, inputs, 2)
        gains = Gains(*(x[0] for x in found))
        n = len(rows.h) + 1
        return Filtered(float(costs[0, 0]) / n, slopes[:, 0] / n, gains, float(costs[0, 1]))

    def _filter_bodies(self) -> "Bodies":
        from ...engines._fused.program import Bodies  # which needs an extra

        def begin(inputs):
            leaves, v, levels, drift, reference, first = inputs["shared"]
            prediction, x0 = self._prediction(leaves, v)

            def run(levels):
                noise = noise_of(levels, drift, reference)
                carry, (gains, cost) = filter_first(
                    prediction, x0, noise, first[0], first[1]
                )
                return (carry, cost), gains

            state, rate, gains = jax.jvp(run, (levels,), (inputs["lane"],), has_aux=True)
            return (state, rate), gains

        def advance(k, pair, inputs):
            del k
            leaves, v, levels, drift, reference, _ = inputs["shared"]
            prediction, _ = self._prediction(leaves, v)

            def run(state, levels):
                carry, before = state
                noise = noise_of(levels, drift, reference)
                carry, (gains, cost) = filter_step(prediction, noise, carry, inputs["log"])
                return (carry, before + cost), gains

            state, rate = pair
            state, rate, gains = jax.jvp(
                run, (state, levels), (rate, inputs["lane"]), has_aux=True
            )
            return (state, rate), gains

        return Bodies(begin, advance, lambda pair, inputs: (pair[0][1], pair[1][1]))

    def _fused_errors(self, v, gains):
        (first, rows), (first_slopes, slopes) = self._signals(v)
        gains = Gains(*(np.asarray(x) for x in gains))
        inputs = {
            "shared": (
                self._leaves,
                np.asarray(v, float),
                np.asarray(self.reference),
                first,
                Gains(*(x[0] for x in gains)),
            ),
            "log": (rows, Gains(*(x[1:] for x in gains))),
            "lane": (np.eye(v.size), first_slopes),
            "lane log": slopes,
        }
        (e, J), _ = self._run("errors", self._error_bodies, inputs, v.size)
        return e[0], np.ascontiguousarray(np.moveaxis(J, 0, -1))

    def _error_bodies(self) -> "Bodies":
        from ...engines._fused.program import Bodies  # which needs an extra

        def begin(inputs):
            leaves, v, reference, first, gains = inputs["shared"]

            def run(v, first):
                prediction, x0 = self._prediction(leaves, v)
                return error_first(prediction, x0, reference, first[0], first[1], gains)

            (s, e), (ds, de) = jax.jvp(run, (v, first), inputs["lane"])
            return (s, ds), (e, de)

        def advance(k, pair, inputs):
            del k
            leaves, v, reference, _, _ = inputs["shared"]
            row, gains = inputs["log"]

            def run(s, v, row):
                prediction, _ = self._prediction(leaves, v)
                return error_step(prediction, reference, s, row, gains)

            (s, e), (ds, de) = jax.jvp(
                run, (pair[0], v, row), (pair[1], inputs["lane"][0], inputs["lane log"])
            )
            return (s, ds), (e, de)

        return Bodies(begin, advance, lambda pair, inputs: None)

    def _run(self, name: str, bodies: "Callable[[], Bodies]", inputs: dict, lanes: int):
        return run_kept((*self._key, name), bodies, inputs, lanes)


def noise_of(levels: Any, drift: Any, reference: Any) -> Noise:
    """The noise of `levels`: logarithms, of that of y over a rough guess of it, and of that
    of the derivatives over their rms."""
    return Noise(jnp.exp(levels[0]) * reference, jnp.exp(levels[1]) * drift, reference)


def _rows(seen: tuple[Signals, np.ndarray, np.ndarray], unknowns: int):
    """Of what is `seen` of a log with the errors of its record taken away, the first sample
    and the rows, and the slopes of both in the `unknowns`, of which a leading axis counts:
    of states and constants there are none."""
    signals, of_u, of_y = seen
    found = (signals.u[0], signals.y[0]), rows_of(signals)
    slopes = jax.tree.map(lambda x: np.zeros((unknowns, *x.shape)), found)
    for j in range(len(of_u)):
        if of_u[j].any() or of_y[j].any():
            (u0, y0), rows = slopes
            u0[j], y0[j] = of_u[j][0], of_y[j][0]
            # Rows are linear in the signals; their intervals are those of the log.
            own = rows_of(Signals(signals.h, of_u[j], of_y[j]))
            for all_of, one in zip(
                jax.tree.leaves(rows), jax.tree.leaves(own), strict=True
            ):
                all_of[j] = one
            rows.h[j] = 0.0
    return found, slopes


@eqx.filter_jit
def _filter(problem: Problem, v, levels, drift, reference):
    """The negative likelihood per row, its slope in the levels, the gains, and the half
    logarithm of the variance of all errors."""
    prediction, x0, signals = problem.prediction(v)

    def cost(levels):
        noise = noise_of(levels, drift, reference)
        gains, value, size = kalman(prediction, x0, noise, signals)
        return value, (value, gains, size)

    slope, (value, gains, size) = jax.jacfwd(cost, has_aux=True)(levels)
    return value, slope, gains, size


@eqx.filter_jit
def _whitened(problem: Problem, v, reference, gains: Gains):
    """The errors and their slopes in the unknowns."""

    def rows(v):
        prediction, x0, signals = problem.prediction(v)
        found = errors(prediction, x0, reference, gains, signals)
        return found, found

    slopes, found = jax.jacfwd(rows, has_aux=True)(v)
    return found, slopes
