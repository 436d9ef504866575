"""The rounds of a search: prediction errors along a log, made white and then small."""

import copy
import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .information import Information, information
from .passes import Passes
from .problem import HELD, Problem, predicted
from .profile import Profile, profile
from .start import paired
from .whiten import Gains, Noise

KICK = 0.02  # of the derivatives' rms, the first guess of what disturbs them
DISTURBED, ALONE = 1e-3, 1e-5  # of the same: what may be too much, and what is nothing
PRIOR = 1.0  # standard deviation of the logarithm of a parameter: it keeps what the record
# does not tell at home, and tells nothing against it
FINE = 1e-6  # of the likelihood per row, to which noise levels are found
LIKELY = 2.0  # of a log-likelihood, which falls by less between levels as good
NEAR = 1e-3  # of a parameter, between two slopes of which one is taken
FARTHEST = 1.5  # from the estimate, of a parameter's logarithm: no interval reaches there


class Round(NamedTuple):
    unknowns: Float[np.ndarray, " v"]
    information: Information


class Search:
    """The rounds of a search: noise levels, the gains that belong to them, least squares.

    The gains are frozen while squares are made least: what they change in the errors is of
    second order, and the errors then cost no more than a simulation.

    One effect of theirs is of first order. Errors are gaps over what the noise of a sample
    makes of them, D; their variance is one of noise and one of the prediction, P / D^2. A
    parameter that makes D large makes the second small, which is no merit: the slope of
    `sum e^2 / 2` at the true parameters is that of the half logarithm of the variances on
    average, and not zero. It is taken away, as the `pull`, so that the estimate is where
    the rest vanishes. Without it an inductance is found some 10 % too high where the
    direct current is zero, and little else is known of it."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        y = np.asarray(problem.signals.y)
        drift = problem.drift()
        prediction, _, _ = predicted(
            problem.parameters, problem.form, problem.states, problem.unknowns
        )
        rms = np.sqrt(np.mean(drift**2, axis=0))[list(prediction.disturbed)]
        self.passes = Passes(problem, np.maximum(rms, 1e-12), _rough(y))
        self.levels = np.array([0.0, np.log(KICK)])
        self.likelihood = -np.inf
        every = len(problem.parameters.names)
        self.k = len(problem.found)
        self.free = np.ones(problem.unknowns.size, bool)
        self.free[self.k : every] = False
        self.pull = self.doubt = np.zeros(self.k)
        self.plausible = np.zeros(0)

    @property
    def prior(self) -> Float[np.ndarray, " w"]:
        """The curvature of what is known beforehand of every unknown that is free."""
        found = np.zeros(np.count_nonzero(self.free))
        found[: self.k] = PRIOR**-2
        found[self.k : self.k + self.plausible.size] = self.plausible**-2.0
        if self.problem.form.answers:
            found[-1] = HELD**-2
        return found

    def round(self, v: Float[np.ndarray, " v"]) -> Round:
        """One round from the unknowns `v`."""
        return self._least(v, self._gains(v))

    def last_round(self, v: Float[np.ndarray, " v"]) -> Round:
        """One round more, with the pull, between those of the noise levels that the record
        may have had: half their difference is the `doubt`."""
        lower, upper = (self._pull(v, levels) for levels in self._between(v))
        self.pull, self.doubt = 0.5 * (upper + lower), 0.5 * np.abs(upper - lower)
        return self._least(v, self.gains)

    def beside(
        self, v: Float[np.ndarray, " v"], places: Sequence[int], plausible: float
    ) -> tuple["Search", Round]:
        """Another search from the unknowns `v`, with the same gains, to which the tested
        parameters at `places` are free as well, of `plausible` standard deviation; and what
        it found."""
        other = copy.copy(self)
        other.free = self.free.copy()
        other.free[list(places)] = True
        other.plausible = np.full(len(places), plausible)
        return other, other._least(v, self.gains)

    def _least(self, v: Float[np.ndarray, " v"], gains: Gains) -> Round:
        """Squares made least, with gains that are kept."""
        from scipy.optimize import least_squares  # heavy to import

        weight = np.sqrt(self.prior)
        home = np.zeros(weight.size)
        home[: self.k] = PRIOR**2 * self.pull
        if self.problem.form.answers:
            home[-1] = HELD
        known = np.diag(weight)[weight > 0]

        def evaluated(w):
            e, J = self.passes.whitened(self.whole(w, v), gains)
            rows = np.concatenate([np.ravel(e), known @ (w - home)])
            J = J[..., self.free]
            return rows, np.concatenate([J.reshape(-1, w.size), known])

        self.evaluate = evaluated
        rows, slopes = paired(evaluated)
        solution = least_squares(
            rows,
            v[self.free],
            jac=slopes,  # pyright: ignore[reportArgumentType]
            method="lm",
            x_scale="jac",
            max_nfev=15,
        )
        v = self.whole(solution.x, v)
        self.gains = gains
        self.errors, self.slopes = self.passes.whitened(v, gains)
        own = self.slopes[..., self.free]
        return Round(v, information(self.errors, own, self.k, self.prior))

    def whole(
        self, free: Float[np.ndarray, " w"], v: Float[np.ndarray, " v"]
    ) -> Float[np.ndarray, " v"]:
        """The unknowns `v` with other values of those that are free."""
        v = np.array(v)
        v[self.free] = free
        return v

    def profiles(
        self,
        v: Float[np.ndarray, " v"],
        known: Information,
        confidence: float,
        resolution: float,
    ) -> list[Profile]:
        """Of every parameter, about the unknowns `v` that a round has found; an interval
        that is no parabola and wider than `resolution`, relative, has no ends."""
        variance = float(np.mean(self.errors**2))
        doubt = self.doubtful(known)

        def inflation(w, j):
            e, J = self.passes.whitened(self.whole(w, v), self.gains)
            own = J[..., self.free]
            return float(information(e, own, self.k, self.prior).inflation[j])

        def profiled(j: int, degrees: int) -> Profile:
            return profile(
                self.evaluate,
                v[self.free],
                j,
                variance,
                float(known.deviation[j] / np.sqrt(known.inflation[j])),
                confidence,
                functools.partial(inflation, j=j),
                FARTHEST,
                degrees,
                resolution * (abs(v[j]) if self.problem.parameters.signed[j] else 1.05),
            )

        found = [profiled(j, 1) for j in range(self.k)]
        if not all(p.parabolic for p in found):
            found = [profiled(j, 2) if p.parabolic else p for j, p in enumerate(found)]
        return [
            dataclasses.replace(p, low=p.low - d, high=p.high + d)
            for p, d in zip(found, doubt, strict=True)
        ]

    def doubtful(self, known: Information) -> Float[np.ndarray, " k"]:
        """How far the parameters may be off as their pull is not known."""
        variance = float(np.mean(self.errors**2))
        inverse = np.linalg.pinv(known.curvature, hermitian=True) / variance
        return np.abs(inverse) @ self.doubt

    def noise(self) -> Noise:
        """The noise that was found."""
        return self.passes.noise(self.levels)

    def _gains(self, v: Float[np.ndarray, " v"]) -> Gains:
        """Those of the noise levels of greatest likelihood."""
        from scipy.optimize import minimize  # heavy to import

        def cost(levels):
            found = self.passes.filtered(v, levels)
            return found.cost, found.slope

        def least(levels):
            return minimize(
                cost,
                levels,
                jac=True,
                method="L-BFGS-B",
                bounds=[(-7.0, 7.0), (np.log(1e-8), np.log(3.0))],
                options={"maxiter": 15, "ftol": FINE},
            )

        found = least(self.levels)
        form = self.problem.form
        if (form.coordinates or form.modelled) and found.x[1] > np.log(DISTURBED):
            # Output errors alone are a maximum of their own: of positions the disturbance
            # of accelerations hides below the noise, and that of the rate of an output can
            # be taken for the noise itself.
            alone = least(np.array([self.levels[0], np.log(ALONE)]))
            found = min(found, alone, key=lambda f: f.fun)
        self.levels = found.x
        last = self.passes.filtered(v, found.x)
        self.likelihood = -last.cost * len(self.problem.signals.y)
        return last.gains

    def _pull(
        self, v: Float[np.ndarray, " v"], levels: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, " k"]:
        """The slope of the half logarithm of all variances in the parameters."""
        found = np.zeros(self.k)
        for j in range(self.k):
            ends = [v.copy(), v.copy()]
            ends[0][j] -= NEAR
            ends[1][j] += NEAR
            low, high = (self.passes.filtered(v, levels).size for v in ends)
            found[j] = (high - low) / (2.0 * NEAR)
        return found

    def _between(self, v: Float[np.ndarray, " v"]) -> list[np.ndarray]:
        """Noise levels about as likely as those that were found, with less of the
        disturbance of the derivatives and with more."""

        def unlikely(level: float) -> float:
            cost = self.passes.filtered(v, np.array([self.levels[0], level])).cost
            return cost * len(self.problem.signals.y) + self.likelihood

        found = []
        for side in (-1.0, 1.0):
            level = float(self.levels[1])
            for step in (0.7, 1.4, 2.8, 2.8):
                if unlikely(level + side * step) > LIKELY:
                    break
                level += side * step
            found.append(np.array([self.levels[0], level]))
        return found


def _rough(y: Float[np.ndarray, "N p"]) -> Float[np.ndarray, " p"]:
    """The noise of signals from their third differences, of which a smooth signal has
    little; its variance there is 20 times its own."""
    third = np.abs(np.diff(y, 3, axis=0))
    size = np.sqrt(np.mean(y**2, axis=0))
    deviation = np.median(third, axis=0) / 0.6745 / np.sqrt(20.0)
    return np.maximum(deviation, 1e-7 * np.maximum(size, 1e-300))
