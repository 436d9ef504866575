"""Calibration: parameters of a model from a log, with intervals that can be trusted."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .adequacy import findings, scored, tested, undecided
from .alternatives import alternatives, together, widened
from .encoder import NAME, check_angle, encoder_offset
from .imperfections import Recorded, fitted, perfect
from .parameters import chosen
from .problem import problem_of
from .result import Calibration, summed_up
from .search import Search
from .whiten import Signals

SETTLED = 0.05  # a change in standard deviations that ends the search
GAINED = 1.0  # in log-likelihood, by a round, at most


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
    fit: Sequence[str] = (),
    angle: ArrayLike | None = None,
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
      o.relation.inductance)`. A parameter that is not zero at first keeps its sign; it may
      be a factor of two off;
    - `cutoff`: of the algebraic observers of a plant (rad/s), by default from the log;
    - `constant`: whether the relations hold up to an unknown constant, which is then found
      as well. By default where the observer does without the magnet flux, and `where` does
      not ask for it; with `False` the magnet flux of the model is taken as known;
    - `scale`: by name, the size of a parameter that starts at zero, in its units;
    - `resolution`: a parameter is determined where no end of its interval is further from
      it than this share of it;
    - `confidence`: of the intervals;
    - `rounds`: at most; a search that has not settled by then determines nothing;
    - `fit`: errors of the record that are found as well: `"offset"` of the outputs,
      `"input_offset"`, `"gain"` of the inputs, `"dead_time"` of an inverter, `"delay"` of
      the inputs; see `Imperfections`. Gain, resistances, inductances and magnet fluxes
      have one scale in common, so that one of these must be left out of `where`. An offset
      of the outputs and one of the inputs cannot be told apart. `"threshold"` (A) is that
      of a dead time. `"encoder_offset"` (rad) is how far `angle` is ahead of the magnet,
      and has no interval;
    - `angle`: the electrical angle of the log (rad), shape `(N,)`, for that offset only;
    - `progress`: is told of every round.

    **Returns:** a [`Calibration`][]. Its intervals are those of the profile of the squares,
    which need not be a parabola, wider where the spread of slopes over blocks of the record
    says that the errors are not white. Errors of the record that are not fitted are tested:
    where one of them explains what is left, it is named and the intervals are withdrawn.
    Where the profile of a parameter is no parabola, or correlated errors leave the test
    undecided, each of them is fitted too, one at a time, and the intervals hold whichever
    of them is right, or none.

    **Raises:** `ValueError` for a `model` or `where` that does not fit, where no estimate
    is certified in the log, and as [`replay`][].

    Source: prediction errors, Ljung, "System Identification", 1999, chapters 7 and 9;
    theory, section 9.
    """
    from scipy.special import ndtri  # scipy.stats takes as long to import as JAX

    t, u, y = (np.asarray(signal, float) for signal in (t, u, y))
    encoder = check_angle(model, angle, t) if NAME in fit else None
    asked = tuple(dict.fromkeys(fitted(name) for name in fit if name != NAME))
    recorded = Recorded(
        model, perfect(model, Signals(*map(jnp.asarray, (np.diff(t), u, y))))
    )
    tests = tested(model, u, y, asked)
    errors = lambda r: tuple(getattr(r.imperfections, f) for f in (*asked, *tests))
    selected = chosen(recorded, lambda r: (where(r.model), *errors(r)))
    problem = problem_of(
        selected, t, u, y, cutoff, constant, scale or {}, _entries(recorded, tests)
    )
    search = Search(problem)
    factor = float(ndtri(0.5 + 0.5 * confidence))
    v, done = problem.unknowns, 0
    while True:
        done, before, likelihood = done + 1, v, search.likelihood
        v, known = search.round(before)
        # What wanders along directions of which the record says little need not settle.
        moved = known.moved((v - before)[: search.k], resolution / factor)
        progress(f"round {done}: the parameters move by {moved:.2g} deviations")
        settled = moved <= SETTLED and search.likelihood - likelihood <= GAINED
        if settled or done >= rounds:
            break
    v, known = search.last_round(v)
    profiles = search.profiles(v, known, confidence, resolution)
    scores = scored(search, tests)
    seen = findings(scores)
    if undecided(search.errors.size, scores) or not all(
        profile.parabolic for profile in profiles
    ):
        others = alternatives(search, v, tests)
        seen = together(seen, others)
        profiles = widened(profiles, others, confidence)
    found = summed_up(
        problem=problem,
        v=v,
        known=known,
        profiles=profiles,
        findings=seen,
        factor=factor,
        confidence=confidence,
        resolution=resolution,
        noise=search.noise(),
        disturbance=float(np.exp(search.levels[1])),
        t=t[t.size - len(search.errors) :],
        errors=search.errors,
        rounds=done,
        settled=settled,
    )
    if encoder is None:
        return found
    ahead = encoder_offset(problem, v, (t, u, y), encoder, cutoff)
    return found.beside(NAME, ahead)


def _entries(recorded: Recorded, fields: Sequence[str]) -> int:
    return sum(np.size(getattr(recorded.imperfections, field)) for field in fields)
