"""Where the search starts: parameters with which the algebraic estimate satisfies the
relation best, and the states and constants that go with them."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from .parameters import Parameters
from .predict import Relation
from .relative import Observers, Relative
from .whiten import Signals


class Turned(ValueError):
    """A record that fits the machine far better with the sign of its outputs turned."""


STARTS = 2  # of several, that are followed
CLEAR = 5.0  # times better is no chance
UNSURE = 3.0  # of half the sum of squares, below which a fit leaves nothing to ask


def typical_cutoff(relations: tuple[Relation, ...], signals: Signals) -> float:
    """A cutoff (rad/s) for plants whose observer is not given: the frequency at which the
    derivatives of the states turn in the log, over sqrt(3), and at least 5.

    It is the ratio of the rms of the derivative to that of its integral, about steady
    motion, which noise hardly moves."""
    h, u, y = signals
    t = np.concatenate([[0.0], np.cumsum(h)])
    rates = []
    for relation in relations:
        z = np.asarray(jax.vmap(lambda u, y, r=relation: r(u, y).z)(u, y))
        x = np.concatenate(
            [np.zeros((1, z.shape[1])), np.cumsum(0.5 * h[:, None] * (z[1:] + z[:-1]), 0)]
        )
        trend = np.stack([np.ones_like(t), t, t**2], axis=1)
        x = x - trend @ np.linalg.lstsq(trend, x, rcond=None)[0]
        rates.append(np.sqrt(np.mean(z**2) / max(np.mean(x**2), 1e-300)))
    return max(float(max(rates)) / np.sqrt(3.0), 5.0)


def first_guess(
    parameters: Parameters,
    observers: Observers,
    t: Float[np.ndarray, " N"],
    signals: Signals,
    open_constants: tuple[bool, ...],
    tested: int,
) -> Float[np.ndarray, " k"]:
    """The parameters for which the relations of the algebraic estimates hold best: of a
    motor, for which the weighted relative variance of `|flux - L i|^2` is least.

    Rate relations of one unknown hold by construction: they start where they are."""
    solved, cost = _solved(
        Relative(parameters, observers, t, signals, open_constants, tested)
    )
    h, u, y = signals
    turned = Relative(parameters, observers, t, Signals(h, u, -y), open_constants, tested)
    if cost > UNSURE and _solved(turned)[1] < cost / CLEAR:
        raise Turned(
            "No calibration: with the sign of all outputs turned the log fits the "
            f"machine at least {CLEAR:g} times better; are currents counted out of it? "
            "Turn their sign (option --column, for instance i_alpha=-i_alpha), or that of "
            "the inputs."
        )
    return solved


def _solved(cost: Relative) -> tuple[Float[np.ndarray, " k"], float]:
    """The parameters for which the `cost` is least, and it, from the best of several
    starts, a factor of two apart."""
    from scipy.optimize import least_squares  # heavy to import

    k = cost.parameters.value.size - cost.tested
    signed = np.array(cost.parameters.signed)[:k]
    steps = [np.log(2.0) * np.eye(k)[j] * s for j in range(k) for s in (1, -1)]
    starts = [np.zeros(k), *(s for s in steps if not signed[np.argmax(np.abs(s))])]
    rows, slopes = paired(cost)
    costs = [float(np.sum(rows(q) ** 2)) for q in starts]
    others = sorted(range(1, len(starts)), key=costs.__getitem__)[: STARTS - 1]

    def solved(k: int):
        return least_squares(
            rows,
            starts[k],
            jac=slopes,  # pyright: ignore[reportArgumentType]
            method="lm",
            max_nfev=30,
        )

    best = solved(0)
    for k in others:
        found = solved(k)
        # What noise makes of the cost has minima of its own: those at home come first.
        if found.cost < best.cost / 2:
            best = found
    return np.concatenate([best.x, np.zeros(cost.tested)]), float(best.cost)


def paired(evaluate: Callable[[np.ndarray], Any]) -> tuple[Callable, Callable]:
    """Values and slopes as two functions, from one that gives both: the solver asks for
    them one after the other at the same point."""

    @functools.lru_cache(maxsize=2)
    def at(bytes_of_x):
        return tuple(np.asarray(part) for part in evaluate(np.frombuffer(bytes_of_x)))

    return (lambda x: at(x.tobytes())[0]), (lambda x: at(x.tobytes())[1])
