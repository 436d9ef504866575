"""A system whose observer is derived, with a motion of it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from aslo_jax.derivation import Model

GRAVITY = 9.81


class Case(NamedTuple):
    """A `model` and a motion of it: `signals(t, s)` are x, y and u of a state s that begins
    at `start` and changes by `rate(t, s)`; by default s is x and y, and u is `drive(t)`.

    `figure`: the relative error of every entry of the relation's x, after `since` (s).
    """

    model: Model
    start: list[float]
    figure: float
    cutoff: float
    horizon: float
    drive: Callable[..., Any] = lambda t: []
    signals: Callable[..., Any] | None = None
    rate: Callable[..., Any] | None = None
    since: float = 0.01
    completion: str = "repeat"

    def of(self, t: Any, s: Any) -> tuple[Any, Any, Any]:
        """x, y and u at an instant."""
        if self.signals is not None:
            return tuple(stacked(each) for each in self.signals(t, s))
        n = len(self.model.ranges)
        return s[:n], s[n:], stacked(self.drive(t))

    def slope(self, t: Any, s: Any) -> Any:
        if self.rate is not None:
            return stacked(self.rate(t, s))
        x, y, u = self.of(t, s)
        p = jnp.asarray(self.model.values())
        rates = self.model.measured_rates(x, y, u, p)
        return jnp.stack([*self.model.rates(x, y, u, p), *rates.values()])


def stacked(parts: Any) -> Any:
    if not isinstance(parts, list | tuple):
        return parts
    return jnp.concatenate([jnp.ravel(jnp.asarray(p, float)) for p in [*parts, []]])


def around(mean: float, swing: float, frequency: float) -> Callable:
    return lambda t: [mean + swing * jnp.sin(frequency * t)]
