"""One descent after another with an optimiser of optax, and why each of them ended."""

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._extras import require
from .._typing import Stopped
from ._gradients import Slope, with_gradient

CONVERGED: Final = "converged"
STALLED: Final = "no improvement"
LIMIT: Final = "iteration limit"
NOT_FINITE: Final = "not finite"


class Limits(NamedTuple):
    """When a descent ends: after `steps` iterations; at a gradient (of the loss in
    logarithms of the leaves, say) below `tolerance` times the loss; when the loss has not
    fallen by the part `improvement` of itself in `patience` iterations. If not `relative`,
    the size of the loss counts as one."""

    steps: int
    tolerance: float
    improvement: float
    patience: int
    relative: bool = True


class History(NamedTuple):
    """One descent, iteration by iteration: the `loss`, shape `(K,)`; the `parameters`, in
    their own units, shape `(K, P)`; the `gradient_norm`, the largest slope of the loss in
    any coordinate (of a positive leaf, its logarithm), shape `(K,)`. `stopped` says why it
    ended: `"converged"`, `"no improvement"`, `"iteration limit"` or `"not finite"`."""

    loss: Float[np.ndarray, " K"]
    parameters: Float[np.ndarray, "K P"]
    gradient_norm: Float[np.ndarray, " K"]
    stopped: Stopped

    @property
    def best(self) -> int:
        """The iteration with the least loss."""
        return int(np.argmin(np.where(np.isfinite(self.loss), self.loss, np.inf)))


class Descent:
    """An optimiser at work on one function: compiled once, for any start and data."""

    def __init__(self, slope: Slope, optimiser: Any, limits: Limits) -> None:
        import optax

        self.slope, self.limits = slope, limits
        self.optimiser = optax.with_extra_args_support(optimiser)
        function = with_gradient(slope)

        @jax.jit
        def step(z, state, known, data, size):
            # Of the size of one whatever the units: optimisers have absolute constants.
            value, gradient = known[0] / size, known[1] / size
            updates, state = self.optimiser.update(
                gradient,
                state,
                z,
                value=value,
                grad=gradient,
                value_fn=lambda z: function(z, data) / size,
            )
            return optax.apply_updates(z, updates), state

        self._step = step

    def run(
        self, start: np.ndarray, data: Any, progress: Any
    ) -> tuple[np.ndarray, History]:
        """From `start` to the end; every point visited, shape `(K, P)`, and the history,
        with these points for parameters. `progress(loss)` is called at each iteration."""
        z = jnp.asarray(start)
        state = self.optimiser.init(z)
        known = self.slope(z, data)
        size = jnp.abs(known[0])
        usable = jnp.isfinite(size) & (size > 0) & self.limits.relative
        size = jnp.where(usable, size, 1.0)
        points, losses, norms = [], [], []
        while True:
            value, gradient = float(known[0]), np.asarray(known[1])
            points.append(np.asarray(z))
            losses.append(value)
            norms.append(float(np.abs(gradient).max()))
            progress(value)
            stopped = self._stopped(losses, norms, points)
            if stopped is not None:
                break
            z, state = self._step(z, state, known, data, size)
            known = self._known(z, state, data, size)
        path = np.stack(points)
        return path, History(np.array(losses), path, np.array(norms), stopped)

    def _known(self, z, state, data, size):
        """The value and the gradient at z, where a line search may have left them."""
        import optax

        kept = [optax.tree.get(state, name) for name in ("value", "grad")]
        if kept[0] is None or kept[1] is None or not np.isfinite(kept[0]):
            return self.slope(z, data)
        return kept[0] * size, kept[1] * size

    def _stopped(
        self, losses: list[float], norms: list[float], points: list[Any]
    ) -> Stopped | None:
        limits, value, norm = self.limits, losses[-1], norms[-1]
        if not (np.isfinite(value) and np.isfinite(norm)):
            return NOT_FINITE
        # A loss of zero has no relative slope: what counts then is what it began with.
        size = max(abs(value), 1e-9 * abs(losses[0])) if limits.relative else 1.0
        if norm <= limits.tolerance * size:
            return CONVERGED
        k = len(losses) - 1
        if k and np.array_equal(points[-1], points[-2]):
            return STALLED
        if k >= limits.patience:
            before = min(losses[: -limits.patience])
            size = abs(before) if limits.relative else 1.0
            if not min(losses) < before - limits.improvement * size:
                return STALLED
        return LIMIT if k >= limits.steps else None


def progress_bar(total: int, shown: bool) -> Any:
    """A bar of tqdm that advances at each call with a loss, or a call without effect; and
    what closes it."""
    if not shown:
        return (lambda loss: None), (lambda: None)
    bar = require("tqdm", "study").tqdm(total=total, unit="iteration")

    def advance(loss: float) -> None:
        bar.set_postfix_str(f"loss {loss:.4g}")
        bar.update()

    return advance, bar.close
