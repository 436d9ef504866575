"""Calibration: prediction errors along a log, made white and then small."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .information import Information, information
from .parameters import chosen
from .problem import Problem, problem_of
from .result import Calibration, Undetermined
from .start import PRIOR, paired
from .whiten import Gains, Noise, errors, kalman

SETTLED = 0.05  # a change in standard deviations that ends the search
NEGLIGIBLE = 0.1  # a share of a direction that is not worth its name
GAINED = 1.0  # in log-likelihood, by a round, at most
KICK = 0.02  # of the derivatives' rms, the first guess of what disturbs them


def calibrate(
    model: Any,
    t: ArrayLike,
    u: ArrayLike,
    y: ArrayLike,
    where: Callable[[Any], Any],
    *,
    cutoff: float | None = None,
    constant: bool | None = None,
    scale: Mapping[str, float] | None = None,
    resolution: float = 0.01,
    confidence: float = 0.95,
    rounds: int = 12,
    progress: Callable[[str], Any] = lambda text: None,
) -> Calibration:
    """Find parameters of a machine from a log, without ground truth.

    The relation that an observer rests on must hold for the states that it predicts, at
    every sample: of a motor `|phi - L i|` is constant. Its gaps are made white by a Kalman
    filter whose noise levels are found from the log too, and their squares are made least.
    So the estimate is that of greatest likelihood for currents (or positions) with white
    noise and disturbed derivatives, whatever the speed does in the log. The noise of a
    current that enters its own prediction, which biases plain least squares, is accounted
    for. The search starts from the parameters for which the algebraic estimate itself
    satisfies the relation best, since far off the gaps have other minima.

    **Arguments:**

    - `model`: an [`AlgebraicObserver`][], an [`Asymptotic`][], observers side by side, a
      [`BearingObserver`][]; or a plant: a machine with a flux relation, or a mechanical
      system. A parameter that two relations share is shared in a plant only;
    - `t` (s), `u`, `y`: the log, as for [`replay`][], arrays of shape `(N,)`, `(N, m)`,
      `(N, p)`; angles may wrap;
    - `where`: the leaves of `model` to be found, `lambda o: (o.relation.resistance,
      o.relation.inductance)`; see [`Corrected`][] for the gain of the supply and offsets;
    - `cutoff`: of the algebraic observers of a plant (rad/s), by default from the log;
    - `constant`: whether the relations hold up to an unknown constant, which is then found
      as well. By default where the observer does without the magnet flux, and `where` does
      not ask for it; with `False` the magnet flux of the model is taken as known;
    - `scale`: by name, the size of a parameter that starts at zero, in its units;
    - `resolution`: a parameter is determined where the half width of its interval is less
      than this share of it;
    - `confidence`: of the intervals;
    - `rounds`: at most;
    - `progress`: is told of every round.

    **Returns:** a [`Calibration`][]. Its intervals come from the curvature of the squares
    and, robust against errors that are not quite white, from the spread of their slopes.

    **Raises:** `ValueError` for a `model` or `where` that does not fit, where no estimate
    is certified in the log, and as [`replay`][].

    Source: prediction errors, Ljung, "System Identification", 1999, chapters 7 and 9;
    theory, section 9.
    """
    import scipy.linalg  # heavy to import, and needed for a calibration only
    import scipy.stats

    t, u, y = (np.asarray(signal, float) for signal in (t, u, y))
    problem = problem_of(chosen(model, where), t, u, y, cutoff, constant, scale or {})
    search = _Search(problem)
    k = len(problem.parameters.names)
    factor = float(scipy.stats.norm.ppf(0.5 + 0.5 * confidence))
    v, basis = problem.unknowns, np.eye(k)
    flat, sizes = np.zeros((k, 0)), []
    done = 0
    while True:
        done, before, likelihood = done + 1, v, search.likelihood
        v, known = search.round(before, basis)
        # What wanders along flat directions need not settle. They are taken out when the
        # rest and the noise have: before, a model that is off looks like noise, in which
        # everything is flat.
        news = known.flat(factor, resolution, basis)
        rest = scipy.linalg.null_space(np.concatenate([flat, news], axis=1).T)
        moves = np.abs(rest.T @ (v - before)[:k]) / known.along(rest)
        moved = float(np.max(moves, initial=0.0))
        progress(f"round {done}: the parameters move by {moved:.2g} deviations")
        gained = search.likelihood - likelihood
        settled = moved <= SETTLED and gained <= GAINED
        if not settled and done < rounds:
            continue
        if news.shape[1] == 0:
            reason = "it settled" if settled else "the rounds are used up"
            break
        sizes += list(known.along(news))
        flat = np.concatenate([flat, news], axis=1)
        basis = scipy.linalg.null_space(flat.T)
        # What was found along flat directions is given up: there it is where it started.
        v = np.concatenate([basis @ (basis.T @ v[:k]), v[k:]])
        if basis.shape[1] == 0:
            reason = "nothing is determined"
            break
        rounds = max(rounds, done + 2)
    return _result(
        search, v, known.deviation, flat, sizes, factor, confidence, done, reason
    )


def _result(search, v, deviation, flat, sizes, factor, confidence, done, reason):
    problem, k = search.problem, flat.shape[0]
    parameters = problem.parameters
    names, scale = parameters.names, parameters.scale
    share = np.abs(flat) / np.max(np.abs(flat), axis=0, keepdims=True, initial=1e-300)
    unknown = np.any(share > NEGLIGIBLE, axis=1)
    after = np.where(unknown, np.nan, parameters.value + scale * v[:k])
    half = np.where(unknown, np.nan, factor * deviation * scale)
    undetermined = []
    for direction, size in zip(flat.T, sizes, strict=True):
        largest = direction[np.argmax(np.abs(direction))]
        parts = dict(zip(names, (direction / largest).tolist(), strict=True))
        parts = {name: x for name, x in parts.items() if abs(x) > NEGLIGIBLE}
        undetermined.append(Undetermined(parts, float(size)))
    noise = _noise(search.levels, search.drift, search.reference)
    e = search.errors - np.mean(search.errors, axis=0)
    return Calibration(
        model=problem.split(v)[0],
        before=dict(zip(names, parameters.value.tolist(), strict=True)),
        after=dict(zip(names, after.tolist(), strict=True)),
        interval={
            name: (float(a - h), float(a + h))
            for name, a, h in zip(names, after, half, strict=True)
        },
        undetermined=tuple(undetermined),
        confidence=confidence,
        output_noise=np.asarray(noise.output),
        drift_noise=np.asarray(noise.drift),
        correlation=float(np.sum(e[1:] * e[:-1]) / np.sum(e * e)),
        rounds=done,
        reason=reason,
    )


class _Round(NamedTuple):
    unknowns: Float[np.ndarray, " v"]
    information: Information


class _Search:
    """The rounds of a search: noise levels, the gains that belong to them, least squares.

    The gains are frozen while squares are made least: what they change in the errors is of
    second order, and the errors then cost no more than a simulation."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        y = np.asarray(problem.signals.y)
        drift = problem.drift()
        prediction, _ = problem.prediction(jnp.asarray(problem.unknowns))
        rms = np.sqrt(np.mean(drift**2, axis=0))[list(prediction.disturbed)]
        self.drift = np.maximum(rms, 1e-12)
        self.reference = _rough(y)
        self.levels = np.array([0.0, np.log(KICK)])
        self.errors, self.likelihood = np.zeros((0, 1)), -np.inf

    def round(self, v: Float[np.ndarray, " v"], basis: Float[np.ndarray, "k r"]) -> _Round:
        """One round from the unknowns `v`, along the directions `basis`."""
        from scipy.optimize import least_squares  # heavy to import

        k, r = basis.shape
        gains = self._gains(v)
        prior = np.eye(r, r + v.size - k) / PRIOR

        def whole(w):
            return np.concatenate([basis @ w[:r], w[r:]])

        def evaluated(w):
            e, J = map(np.asarray, _errors(self.problem, whole(w), self.reference, gains))
            rows = np.concatenate([np.ravel(e), w[:r] / PRIOR])
            flat = J.reshape(-1, v.size)
            return rows, np.concatenate(
                [np.concatenate([flat[:, :k] @ basis, flat[:, k:]], axis=1), prior]
            )

        rows, slopes = paired(evaluated)
        solution = least_squares(
            rows,
            np.concatenate([basis.T @ v[:k], v[k:]]),
            jac=slopes,  # pyright: ignore[reportArgumentType]
            method="lm",
            x_scale="jac",
            max_nfev=15,
        )
        v = whole(solution.x)
        e, J = _errors(self.problem, v, self.reference, gains)
        self.errors = np.asarray(e)
        return _Round(v, information(self.errors, np.asarray(J), basis))

    def _gains(self, v: Float[np.ndarray, " v"]) -> Gains:
        """Those of the noise levels of greatest likelihood."""
        from scipy.optimize import minimize  # heavy to import

        def evaluated(levels):
            return _likelihood(self.problem, v, levels, self.drift, self.reference)

        def cost(levels):
            value, slope, _ = evaluated(levels)
            return float(value), np.asarray(slope)

        found = minimize(
            cost,
            self.levels,
            jac=True,
            method="L-BFGS-B",
            bounds=[(-7.0, 7.0), (np.log(1e-8), np.log(3.0))],
            options={"maxiter": 15},
        )
        self.levels, self.likelihood = (
            found.x,
            -float(found.fun) * len(self.problem.signals.y),
        )
        return evaluated(found.x)[2]


def _rough(y: Float[np.ndarray, "N p"]) -> Float[np.ndarray, " p"]:
    """The noise of signals from their third differences, of which a smooth signal has
    little; its variance there is 20 times its own."""
    third = np.abs(np.diff(y, 3, axis=0))
    size = np.sqrt(np.mean(y**2, axis=0))
    deviation = np.median(third, axis=0) / 0.6745 / np.sqrt(20.0)
    return np.maximum(deviation, 1e-7 * np.maximum(size, 1e-300))


def _noise(levels, drift, reference) -> Noise:
    """The noise of `levels`: logarithms, of that of y over a rough guess of it, and of that
    of the derivatives over their rms."""
    return Noise(jnp.exp(levels[0]) * reference, jnp.exp(levels[1]) * drift, reference)


@eqx.filter_jit
def _likelihood(problem: Problem, v, levels, drift, reference):
    """Negative, per row; its slope in the levels; and the gains that belong to them."""
    prediction, x0 = problem.prediction(v)

    def cost(levels):
        noise = _noise(levels, drift, reference)
        gains, value = kalman(prediction, x0, noise, problem.signals)
        return value, (value, gains)

    slope, (value, gains) = jax.jacfwd(cost, has_aux=True)(levels)
    return value, slope, gains


@eqx.filter_jit
def _errors(problem: Problem, v, reference, gains: Gains):
    """The errors and their slopes in the unknowns."""

    def rows(v):
        prediction, x0 = problem.prediction(v)
        found = errors(prediction, x0, reference, gains, problem.signals)
        return found, found

    slopes, found = jax.jacfwd(rows, has_aux=True)(v)
    return found, slopes
