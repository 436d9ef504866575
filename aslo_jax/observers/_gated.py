"""Outliers: samples that are too far from where they should be are left out."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import kind, positive, real
from .._filters import AbstractLaw
from .._realise import Pass
from .._typing import PyTree
from ._base import AbstractObserver
from ._missing import either, finite


class _Gate(NamedTuple):
    """The last two samples that were accepted and how many intervals lie between them and
    since the last; the mean square of each entry's residual, of how many; and how many
    samples were rejected in a row, -1 after a jump."""

    last: PyTree
    before: PyTree
    apart: Float[Array, ""]
    since: Float[Array, ""]
    square: PyTree
    seen: Float[Array, ""]
    rejected: Float[Array, ""]


class _Kept(AbstractLaw):
    """A state that no equation changes."""

    def flow(self, X: PyTree, v: PyTree) -> Any:
        del v
        return jax.tree.map(jnp.zeros_like, X)

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        del v0, v1, coefficients
        return X


class Gated(AbstractObserver):
    """An observer that takes an outlier of y for a missing sample: it coasts over it, as
    [`AbstractObserver.step`][] says, and flags it.

    A sample is an outlier where an entry is further from the line through the last two
    accepted ones than `threshold` times the root mean square of the residuals so far.

    - `observer`: any, of samples at even intervals;
    - `threshold`, dimensionless: how many times the running spread; noise that is normal
      passes 8 once in 10^15 samples;
    - `least`, in the unit of y: the least spread, such as the step of an encoder, which at
      rest shows none;
    - `patience`: after so many rejected samples in a row the next two are accepted, and the
      line begins anew there: a true jump is followed then. Where the noise has grown, the
      spread doubles each time that happens;
    - `memory`: over how many accepted samples the spread is averaged; the first tenth of
      them is accepted unseen.

    Limits: an outlier among the first tenth of `memory` samples passes, and hides others
    until it is forgotten; one below `threshold` times the spread, which noise and the
    curvature of y over an interval make up, passes; a change of y that is truly so sudden
    costs `patience` samples, as does every jump of an angle that wraps (put [`Unwrapped`][]
    inside, which is asked first); u is not looked at.

    Gains are differentiated as ever, the choice of samples is not.

    **Raises:** `ValueError` for a `patience` or `memory` that is no whole number from 1.
    """

    observer: AbstractObserver
    threshold: Float[Array, ""] = eqx.field(converter=real, default=8.0)
    least: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    patience: int = eqx.field(static=True, default=5)
    memory: int = eqx.field(static=True, default=200)

    def __check_init__(self) -> None:
        kind("observer", self.observer, AbstractObserver, hint="an observer")
        positive("threshold", self.threshold)
        for name in ("patience", "memory"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(
                    f"Argument `{name}` must be a whole number of samples of at least 1, "
                    f"but got {value!r}."
                )

    @property
    def signals(self) -> Any:
        return getattr(self.observer, "signals", {})

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Any:
        zero = jnp.zeros((), jnp.result_type(float, *jax.tree.leaves(y)))
        one = zero + 1.0
        square = jax.tree.map(jnp.zeros_like, y)
        F.evolve(_Kept(), zero, _Gate(y, y, one, one, square, zero, zero), "gate")
        return self.observer(F, u, y)

    def continued(self, before: PyTree, y: PyTree) -> Any:
        return self.observer.continued(before, y)

    def advance(
        self, state: Any, u: PyTree, y: PyTree, coefficients: PyTree, *, substeps=1
    ) -> Any:
        return self.take(state, u, y, 1.0, coefficients, substeps=substeps)

    def take(
        self, state: Any, u: PyTree, y: PyTree, dt: Any, coefficients: PyTree, *, substeps=1
    ) -> Any:
        gate = state.states["gate"]
        y = self.continued(state.y, y)
        there, gate = self._passes(gate, y)
        y = jax.tree.map(lambda x: jnp.where(there, x, jnp.nan), y)
        state = eqx.tree_at(lambda s: s.states["gate"], state, gate)
        return AbstractObserver.take(self, state, u, y, dt, coefficients, substeps=substeps)

    def _passes(self, gate: _Gate, y: PyTree) -> tuple[Bool[Array, ""], _Gate]:
        """Whether a sample is let through, and the gate after it."""
        there = finite(y)
        y = either(there, y, gate.last)
        # The error of a line grows with its reach, which is 1 for the next sample.
        reach = gate.since / gate.apart
        residual = jax.tree.map(
            lambda x, b, a: (
                (x - b - reach.astype(b.dtype) * (b - a)) * (2.0 / (1.0 + reach))
            ).astype(b.dtype),
            y,
            gate.last,
            gate.before,
        )
        far = jnp.asarray(False)
        for r, s in zip(*map(jax.tree.leaves, (residual, gate.square)), strict=True):
            spread = jnp.maximum(s, self.least.astype(s.dtype) ** 2)
            far = far | jnp.any(r * r > self.threshold.astype(s.dtype) ** 2 * spread)
        unseen = gate.seen < max(self.memory // 10, 2)
        weary, anew = gate.rejected >= self.patience, gate.rejected < 0
        outlier = there & far & ~(unseen | weary | anew)
        passes = there & ~outlier
        jumped, learns = passes & weary, passes & ~weary & ~anew
        count = jnp.where(learns, gate.seen + 1.0, gate.seen)
        weight = jnp.where(learns, 1.0 / jnp.clip(count, 1.0, self.memory), 0.0)
        square = jax.tree.map(
            # Noise that has grown is let in after a few jumps.
            lambda s, r: jnp.where(
                jumped, 4.0 * s, s + weight.astype(s.dtype) * (r * r - s)
            ),
            gate.square,
            residual,
        )
        in_a_row = jnp.where(outlier, gate.rejected + 1.0, gate.rejected)
        return passes, _Gate(
            either(passes, y, gate.last),
            either(jumped, y, either(passes, gate.last, gate.before)),
            jnp.where(passes, jnp.where(jumped, 1.0, gate.since), gate.apart),
            jnp.where(passes, 1.0, gate.since + 1.0),
            square,
            count,
            jnp.where(jumped, -1.0, jnp.where(passes, 0.0, in_a_row)),
        )
