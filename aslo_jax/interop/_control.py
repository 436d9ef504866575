"""An observer as a system in discrete time of python-control."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from .._checks import positive
from .._extras import require
from ..observers import AbstractObserver
from ._realised import value_of

__all__ = ["to_nlsys"]


def to_nlsys(observer: AbstractObserver, *, interval: float, u: Any, y: Any) -> Any:
    """An observer as a `control.nlsys` with the sampling interval `interval` (s).

    - `observer`: one that estimates an [`Estimate`][];
    - `u`, `y`: examples of the input and the measurement, vectors of which the shape
      matters.

    At an instant it takes u, held from now on, as `u0`, `u1` and so on, and y, measured
    now, as `y0`; it puts out the entries `value0` of the estimate, `certificate` and
    `coasting`, which are those of [`replay`][]. Its state is that of the observer, the u
    before, and whether it has begun: zeros are the state before the first sample.

    **Raises:** `ValueError` for an interval that is not positive, an observer of several
    estimates, or without float64;
    `ImportError` without python-control.
    """
    control = require("control", "interop")
    positive("interval", interval, "s")
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError("`to_nlsys` needs float64: set jax_enable_x64.")
    u, y = (jnp.atleast_1d(jnp.asarray(x, float)) for x in (u, y))
    state = observer.init(y, u)
    estimate = jax.eval_shape(lambda: observer.estimate(jnp.zeros(()), state, u, y))
    value_of(estimate, type(observer).__name__)
    start, unravel = ravel_pytree((state, u))

    def both(x: Any, given: Any) -> tuple[jax.Array, jax.Array]:
        now, measured = given[: u.size], given[u.size :]

        def first() -> Any:
            state = observer.init(measured, u)
            return state, observer.estimate(jnp.zeros(()), state, now, measured)

        def later() -> Any:
            state, before = unravel(x[:-1])
            return observer.step(state, before, measured, interval)

        state, estimate = jax.lax.cond(x[-1] > 0.5, later, first)
        after = jnp.append(ravel_pytree((state, now))[0], 1.0)
        own = jnp.stack([estimate.certificate, estimate.coasting.astype(float)])
        return after, jnp.concatenate([estimate.value, own])

    run = eqx.filter_jit(both)
    zero = np.zeros(start.size + 1)
    size = run(zero, np.zeros(u.size + y.size))[1].size - 2
    return control.nlsys(
        lambda t, x, given, params: np.asarray(run(x, given)[0]),
        lambda t, x, given, params: np.asarray(run(x, given)[1]),
        inputs=[f"u{k}" for k in range(u.size)] + [f"y{k}" for k in range(y.size)],
        outputs=[*(f"value{k}" for k in range(size)), "certificate", "coasting"],
        states=zero.size,
        dt=interval,
    )
