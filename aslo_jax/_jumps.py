"""Stepping a solver between the instants at which held signals jump.

The vector field at a jump is two-valued. Steps end at the float before a jump and begin at
the ones after it, so that no stage of a solver sees both sides."""

from collections.abc import Iterable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._module import Module
from .disturbances import AbstractDisturbance


class Span(Module):
    """An integration span, with the jumps inside it (s).

    A jump at an end, or a rounding away from one, is none: the vector field at the ends is
    that of the inside. All of it is concrete, under `jax.jit` too.
    """

    jumps: Float[np.ndarray, " jumps"]
    first: Float[np.ndarray, ""]
    last: Float[np.ndarray, ""]

    def inside(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """The time at which the vector field is evaluated for `t`."""
        return t if self.jumps.size == 0 else jnp.clip(t, self.first, self.last)


def span(
    disturbances: Iterable[AbstractDisturbance | Any], t0: float, t1: float
) -> Span | None:
    """The span from `t0` to `t1` (s), or `None` where nothing jumps, neither disturbances
    nor held inputs."""
    parts = [part for part in disturbances if part is not None and part.has_jumps]
    if not parts:
        return None
    dtype = jnp.result_type(float)
    near = 8 * float(jnp.finfo(dtype).eps) * max(abs(t0), abs(t1))
    times = np.unique(np.concatenate([p.jumps(t0 - near, t1 + near) for p in parts]))
    first = max([t0, *times[times <= t0 + near]])
    last = min([t1, *times[times >= t1 - near]])
    inner = times[(times > t0 + near) & (times < t1 - near)]
    return Span(
        np.asarray(inner, dtype),
        np.asarray(first, dtype),
        np.asarray(np.nextafter(np.asarray(last, dtype), np.asarray(-np.inf, dtype))),
    )


def between_jumps(
    steps: diffrax.AbstractStepSizeController,
    span: Span | None,
    t0: float,
    dt0: float | None,
) -> diffrax.AbstractStepSizeController:
    """The step size controller, adaptive or fixed, made to stop at every jump."""
    if span is None:
        return steps
    if isinstance(steps, diffrax.AbstractAdaptiveStepSizeController):
        return diffrax.ClipStepSizeController(steps, jump_ts=jnp.asarray(span.jumps))
    if dt0 is None:
        raise ValueError("Argument `dt0` must be given with fixed steps, but got None.")
    multiples = (span.jumps - t0) / dt0
    off = np.abs(multiples - np.round(multiples))
    if off.size and off.max() > 1e-6:
        raise ValueError(
            f"Argument `dt0` must divide the interval of every held disturbance, but "
            f"steps of {dt0} s pass over the jump at {span.jumps[off.argmax()]} s."
        )
    return _FixedStepsBetweenJumps(span.jumps)


class _FixedStepsBetweenJumps(diffrax.AbstractStepSizeController):
    jumps: Float[np.ndarray, " jumps"]

    def wrap(self, direction):
        del direction
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        del terms, y0, args, func, error_order
        steps = jnp.ceil((t1 - t0) / dt0 * (1 - 1e-9))
        state = (jnp.ones_like(steps), steps, t0, t1, dt0)
        return self._end(state), state

    def _end(self, state):
        k, steps, t0, t1, dt0 = state
        end = t0 + k * dt0
        if self.jumps.size > 0:  # the very float of the jump, not a rounding beside it
            jumps = jnp.asarray(self.jumps)
            after = jnp.clip(jnp.searchsorted(jumps, end), 1, jumps.size - 1)
            for jump in (jumps[after - 1], jumps[after]):
                end = jnp.where(jnp.abs(jump - end) < 1e-5 * dt0, jump, end)
        return jnp.where(k >= steps, t1, _neighbour(end, -jnp.inf))

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        del t0, y0, y1_candidate, args, y_error, error_order
        k, *rest = controller_state
        state = (k + 1, *rest)
        beyond = _neighbour(_neighbour(t1, jnp.inf), jnp.inf)
        next_t0 = jnp.where(k >= rest[0], t1, beyond)
        jumped = jnp.asarray(True)
        return True, next_t0, self._end(state), jumped, state, diffrax.RESULTS.successful


def _neighbour(t, towards):
    return jax.lax.stop_gradient(jnp.nextafter(t, towards))
