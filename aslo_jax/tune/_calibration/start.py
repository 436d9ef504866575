"""Where the search starts: parameters with which the algebraic estimate satisfies the
relation best, and the states and constants that go with them."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._checks import real
from ..._filters import LowPass
from ..._guard import Guard
from ..._module import Module
from ..._relations import Quadratic, Rate
from ..._replay import replay
from ...observers import AlgebraicObserver
from .parameters import Parameters
from .predict import Relation, observers_of, relations_of, residual
from .whiten import Signals

# Of the relative residual of an algebraic estimate over one time constant of its filter,
# and of the parameters' starting values: an estimate of noise and transients, and a guess.
# They matter where the record determines little, and there they keep the search at home.
RESIDUAL, PRIOR = 0.01, 0.3
THRESHOLD = 1e-3  # of the guard of an observer that is not given
STARTS = 2  # of several, that are followed
CLEAR = 5.0  # times better is no chance
UNSURE = 3.0  # of half the sum of squares, below which a fit leaves nothing to ask
TIME_CONSTANTS = 2.0  # of the filter, after which an estimate is used


class Observers(Module):
    """The algebraic observers in an observer, or those of a plant's relations with `cutoff`
    (rad/s)."""

    cutoff: Float[Array, ""] = eqx.field(converter=real)

    def __call__(self, model: Any) -> tuple[AlgebraicObserver, ...]:
        found = observers_of(model)
        if found is None:
            filter, guard = LowPass(self.cutoff), Guard(THRESHOLD)
            relations = relations_of(model) or ()
            found = tuple(AlgebraicObserver(r, filter, guard=guard) for r in relations)
        return found


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


@eqx.filter_jit
def trusted(estimate: Any, t: Float[Array, " N"], observer: AlgebraicObserver) -> Array:
    """The weight of every row of an estimate, of sum one."""
    weight = jnp.where(estimate.coasting, 0.0, estimate.certificate)
    return weight * (t > t[0] + settling(observer))


def settling(observer: AlgebraicObserver) -> Array:
    """The time (s) after which an estimate is used."""
    filter = observer.filter
    if not isinstance(filter, LowPass):
        return jnp.zeros(())
    return TIME_CONSTANTS / filter.slowest


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
        _Relative(parameters, observers, jnp.asarray(t), signals, open_constants), tested
    )
    h, u, y = signals
    turned = _Relative(
        parameters, observers, jnp.asarray(t), Signals(h, u, -y), open_constants
    )
    if cost > UNSURE and _solved(turned, tested)[1] < cost / CLEAR:
        raise ValueError(
            "No calibration: with the sign of all outputs turned the log fits the "
            f"machine at least {CLEAR:g} times better; are currents counted out of it? "
            "Turn their sign (option --column, for instance i_alpha=-i_alpha), or that of "
            "the inputs."
        )
    return solved


def _solved(cost: "_Relative", tested: int) -> tuple[Float[np.ndarray, " k"], float]:
    """The parameters for which the `cost` is least, and it, from the best of several
    starts, a factor of two apart."""
    from scipy.optimize import least_squares  # heavy to import

    k = cost.parameters.value.size - tested
    signed = np.array(cost.parameters.signed)[:k]
    steps = [np.log(2.0) * np.eye(k)[j] * s for j in range(k) for s in (1, -1)]
    starts = [np.zeros(k), *(s for s in steps if not signed[np.argmax(np.abs(s))])]
    rows, slopes = paired(lambda q: _rows(cost, q, tested))
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
    return np.concatenate([best.x, np.zeros(tested)]), float(best.cost)


def paired(evaluate: Callable[[np.ndarray], Any]) -> tuple[Callable, Callable]:
    """Values and slopes as two functions, from one that gives both: the solver asks for
    them one after the other at the same point."""

    @functools.lru_cache(maxsize=2)
    def at(bytes_of_x):
        return tuple(np.asarray(part) for part in evaluate(np.frombuffer(bytes_of_x)))

    return (lambda x: at(x.tobytes())[0]), (lambda x: at(x.tobytes())[1])


class _Relative(Module):
    """The relative residuals of the algebraic estimates, over parameters `q`."""

    parameters: Parameters
    observers: Observers
    t: Float[Array, " N"]
    signals: Signals
    opened: tuple[bool, ...] = eqx.field(static=True)

    def __call__(self, q):
        recorded = self.parameters.place(q)
        t, (_, u, y) = self.t, recorded.imperfections(self.signals)
        found = [q / PRIOR]
        for observer, is_open in zip(
            self.observers(recorded.model), self.opened, strict=True
        ):
            terms = jax.eval_shape(observer.relation, u[0], y[0])
            if isinstance(terms, Rate):
                continue
            estimate = replay(observer, t, u, y)
            gap, slope = jax.vmap(
                lambda x, u, y, o=observer: residual(o.relation(u, y), x)
            )(estimate.value, u, y)
            w = jax.lax.stop_gradient(trusted(estimate, t, observer))
            w = w / jnp.maximum(jnp.sum(w), 1e-300)
            # Relative, so that nothing is gained by a state that shrinks.
            size = jnp.sum(w * jnp.sum(slope**2, axis=1))
            if isinstance(terms, Quadratic):
                first: Any = observer.relation(u[0], y[0])
                n = slope.shape[1]
                Q = jax.vmap(first.times)(jnp.eye(n))
                size = size / jnp.sqrt(jnp.sum(Q**2) / n)
            relative = (gap - is_open * jnp.sum(w * gap)) / size
            windows = (t[-1] - t[0]) / jnp.maximum(settling(observer), t[1] - t[0])
            found.append(jnp.sqrt(w * windows) * relative / RESIDUAL)
        return jnp.concatenate(found)


@eqx.filter_jit
def _rows(cost, q, tested):
    def rows(q):
        found = cost(jnp.concatenate([q, jnp.zeros(tested)]))
        return found, found

    slopes, found = jax.jacfwd(rows, has_aux=True)(q)
    return found, slopes
