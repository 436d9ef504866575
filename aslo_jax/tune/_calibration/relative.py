"""How far algebraic estimates are from satisfying their own relations, relative to their
size, and the slopes of that in the parameters.

The observer runs in the fused engine, where that can compile it, one direction of the
parameters in each lane: XLA takes longer to compile its slopes than the rest of a
calibration takes."""

import importlib.util
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._checked_log import common_interval
from ..._checks import real
from ..._filters import LowPass
from ..._frontend.lower import NotFusible
from ..._guard import Guard
from ..._module import Module
from ..._relations import Quadratic, Rate
from ..._replay import replay
from ...observers import AlgebraicObserver, Estimate
from .imperfections import Sight
from .kept import run_kept
from .parameters import Parameters
from .predict import observers_of, relations_of, residual
from .whiten import Signals

if TYPE_CHECKING:
    from ...engines._fused.program import Bodies

# Of the relative residual of an algebraic estimate over one time constant of its filter,
# and of the parameters' starting values: an estimate of noise and transients, and a guess.
# They matter where the record determines little, and there they keep the search at home.
RESIDUAL, PRIOR = 0.01, 0.3
THRESHOLD = 1e-3  # of the guard of an observer that is not given
LOST = 1e3  # a residual beside which any other is small
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


def trusted(
    estimate: Estimate, t: Float[np.ndarray, " N"], observer: AlgebraicObserver
) -> Float[np.ndarray, " N"]:
    """The weight of every row of an estimate."""
    weight = np.where(estimate.coasting, 0.0, estimate.certificate)
    return weight * (t > t[0] + settling(observer))


def settling(observer: AlgebraicObserver) -> float:
    """The time (s) after which an estimate is used."""
    filter = observer.filter
    return TIME_CONSTANTS / float(filter.slowest) if isinstance(filter, LowPass) else 0.0


class Relative:
    """The relative residuals of the algebraic estimates of a log `t` (s), `signals`, over
    the `parameters`, of which the last `tested` stay where they are; with an unknown
    constant where a relation is `opened`."""

    def __init__(
        self,
        parameters: Parameters,
        observers: Observers,
        t: Float[np.ndarray, " N"],
        signals: Signals,
        opened: tuple[bool, ...],
        tested: int,
    ) -> None:
        self.parameters, self.observers, self.tested = parameters, observers, tested
        self.t, self.signals, self.opened = t, signals, opened
        self._seen = Sight(parameters, signals)
        self.fused = importlib.util.find_spec("llvmlite") is not None
        arrays, self._rest = eqx.partition(
            (parameters, observers), lambda x: isinstance(x, Array | np.ndarray)
        )
        self._leaves, self._tree = jax.tree.flatten(arrays)

    def __call__(
        self, q: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r k"]]:
        """Residuals and their slopes; those of the parameters themselves, which keep what a
        record does not tell at home, come first."""
        whole = np.concatenate([q, np.zeros(self.tested)])
        signals, du, dy = self._seen(whole)
        rows, slopes = [q / PRIOR], [np.eye(q.size) / PRIOR]
        begun = self.observers(self.parameters.place(whole).model)
        for j, observer in enumerate(begun):
            terms = jax.eval_shape(observer.relation, signals.u[0], signals.y[0])
            if isinstance(terms, Rate):
                continue
            (gap, size, w), (gap_q, size_q) = self._along(j, whole, signals, du, dy)
            w = w * (self.t > self.t[0] + settling(observer))
            total = np.sum(w)
            if not total > 0.0:  # nothing is known of the state with these parameters
                rows.append(np.full(gap.shape, LOST))
                slopes.append(np.zeros((gap.size, q.size)))
                continue
            w = w / total
            # Relative, so that nothing is gained by a state that shrinks.
            size, size_q = np.sum(w * size), size_q[: q.size] @ w
            gap_q = gap_q[: q.size]
            if self.opened[j]:
                gap, gap_q = gap - np.sum(w * gap), gap_q - (gap_q @ w)[:, None]
            span, interval = self.t[-1] - self.t[0], self.t[1] - self.t[0]
            weight = np.sqrt(w * span / max(settling(observer), interval)) / RESIDUAL
            rows.append(weight * gap / size)
            change = (gap_q - size_q[:, None] * gap / size) / size
            slopes.append((weight * change).T)
        return np.concatenate(rows), np.concatenate(slopes)

    def _along(self, j: int, q, signals: Signals, du, dy):
        """Of observer `j`, gaps, sizes and certificates of every row, and the slopes of the
        former two."""
        if self.fused:
            try:
                return self._fused(j, q, signals, du, dy)
            except NotFusible:
                self.fused = False
        t = jnp.asarray(self.t)
        found = _plain(self.parameters, self.observers, j, t, self.signals, jnp.asarray(q))
        return jax.tree.map(np.asarray, found)

    def _fused(self, j: int, q, signals: Signals, du, dy):
        interval = common_interval(self.t)
        held = lambda u, y: (u[..., :-1, :], u[..., 1:, :], y[..., 1:, :])
        h, u, y = signals
        shared = (
            self._leaves,
            q,
            u[0],
            y[0],
            None if interval is None else np.asarray(interval),
        )
        inputs = {
            "shared": shared,
            "log": (*held(u, y), h if interval is None else None),
            "lane": (np.eye(q.size), du[:, 0], dy[:, 0]),
            "lane log": held(du, dy),
        }
        key = self._rest, "start", self._tree, j
        (found, slopes), _ = run_kept(key, lambda: self._bodies(j), inputs, q.size)
        return tuple(x[0] for x in found), slopes

    def _bodies(self, j: int) -> "Bodies":
        from ...engines._fused.program import Bodies  # which needs an extra

        def observer_of(leaves, q) -> AlgebraicObserver:
            tree = jax.tree.unflatten(self._tree, leaves)
            parameters, observers = eqx.combine(tree, self._rest)
            return observers(parameters.place(q).model)[j]

        def begin(inputs):
            leaves, q, u, y, interval = inputs["shared"]

            def run(q, u, y):
                observer = observer_of(leaves, q)
                begun = observer.allocate(y, u)
                laws = None if interval is None else begun.discretise(interval)
                state = observer.init(y, u)
                estimate = observer.estimate(jnp.zeros(()), state, u, y)
                (gap, size), w = _row(observer, estimate, u, y)
                smooth, rest = eqx.partition((state, laws), eqx.is_inexact_array)
                return (smooth, (gap, size)), (rest, w)

            (smooth, found), (slope, of_found), (rest, w) = jax.jvp(
                run, (q, u, y), inputs["lane"], has_aux=True
            )
            (state, laws), (d_state, d_laws), (others, fixed) = smooth, slope, rest
            return (state, d_state, others), ((*found, w), of_found), (laws, d_laws, fixed)

        def advance(k, carry, inputs, kept):
            del k
            leaves, q, *_ = inputs["shared"]
            *row, h = inputs["log"]
            state, d_state, others = carry
            laws, d_laws, fixed = kept

            def run(q, state, laws, held, u, y):
                observer = observer_of(leaves, q)
                state, laws = eqx.combine(state, others), eqx.combine(laws, fixed)
                if h is not None:
                    laws = observer.allocate(state.y, held).discretise(h)
                state, estimate = observer.advance(state, held, y, laws)
                found, w = _row(observer, estimate, u, y)
                smooth, rest = eqx.partition(state, eqx.is_inexact_array)
                return (smooth, found), (rest, w)

            at = (q, state, laws, *row)
            along = (inputs["lane"][0], d_state, d_laws, *inputs["lane log"])
            (state, found), (d_state, of_found), (others, w) = jax.jvp(
                run, at, along, has_aux=True
            )
            return (state, d_state, others), ((*found, w), of_found)

        return Bodies(begin, advance, lambda carry, inputs: None)


def _row(observer: AlgebraicObserver, estimate: Estimate, u: Any, y: Any):
    """The gap of the relation, the size that it is compared with, and the certificate,
    zero where the estimate coasts."""
    terms = observer.relation(u, y)
    gap, slope = residual(terms, estimate.value)
    size = jnp.sum(slope**2)
    if isinstance(terms, Quadratic):
        n = slope.shape[0]
        rows = [terms.times(row) for row in jnp.eye(n)]
        size = size / jnp.sqrt(jnp.sum(jnp.stack(rows) ** 2) / n)
    return (gap, size), jnp.where(estimate.coasting, 0.0, estimate.certificate)


@eqx.filter_jit
def _plain(parameters, observers, j, t, signals, q):
    """As [`Relative`][] has it, by XLA."""

    def rows(q):
        recorded = parameters.place(q)
        observer = observers(recorded.model)[j]
        _, u, y = recorded.imperfections(signals)
        estimate = replay(observer, t, u, y)
        found, w = jax.vmap(lambda e, u, y: _row(observer, e, u, y))(estimate, u, y)
        return found, (*found, w)

    slopes, found = jax.jacfwd(rows, has_aux=True)(q)
    return found, jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), slopes)
