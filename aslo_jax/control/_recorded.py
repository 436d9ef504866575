"""Inputs from a log, held between its samples."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _choices
from .._checks import one_of
from .._typing import Hold, Numbers

__all__ = ["RecordedInput"]


class RecordedInput:
    """An open-loop input from a log: give it to [`simulate`][] or a
    [`ContinuousExperiment`][] as the controller. Steps end at its samples.

    - `t`: the instants of the samples (s), increasing, shape `(N,)`; `u`: the input there,
      shape `(N,)` or `(N, m)`, in its units;
    - `hold`: `"zero"` holds `u[k]` from `t[k]` on, as in a log of the library; `"linear"`
      joins the samples by lines.

    Before the first sample and after the last one it is what it is there. It has no
    derivative in its samples.

    **Raises:** `ValueError` for instants that do not increase, for numbers that are not
    finite, for other shapes, and for another `hold`.
    """

    has_jumps = True

    def __init__(
        self,
        t: Numbers,
        u: Numbers,
        hold: Hold = "zero",
    ) -> None:
        one_of("hold", hold, _choices.Hold)
        self.t, self.u, self.hold = np.asarray(t, float), np.asarray(u, float), hold
        if self.t.ndim != 1 or not self.t.size or not (np.diff(self.t) > 0).all():
            raise ValueError("Argument `t` must be a strictly increasing vector.")
        if self.u.ndim not in (1, 2) or len(self.u) != len(self.t):
            raise ValueError(
                f"Argument `u` must have shape ({self.t.size},) or ({self.t.size}, m), one "
                f"row for each instant, but has {self.u.shape}."
            )
        if not (np.isfinite(self.t).all() and np.isfinite(self.u).all()):
            raise ValueError("Arguments `t` and `u` must be finite.")

    def __repr__(self) -> str:
        shape = ", ".join(map(str, self.u.shape))
        return f"RecordedInput(t=f64[{self.t.size}], u=f64[{shape}], hold={self.hold!r})"

    def jumps(self, t0: float, t1: float) -> Float[np.ndarray, " jumps"]:
        """The samples in [t0, t1] (s), where it jumps or bends."""
        return self.t[(self.t >= t0) & (self.t <= t1)]

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "*m"]:
        """The input at time t (s)."""
        times = self.t.astype(t.dtype)
        k = _last(times, t)
        if self.hold == "zero" or self.t.size == 1:
            return self._at(k, t.dtype)
        k = jnp.minimum(k, self.t.size - 2)
        start, end = jnp.asarray(times)[k], jnp.asarray(times)[k + 1]
        part = jnp.clip((t - start) / (end - start), 0.0, 1.0)
        left, right = self._at(k, t.dtype), self._at(k + 1, t.dtype)
        return left + part * (right - left)

    def _at(self, k: Array, dtype: np.dtype) -> Array:
        columns = self.u.reshape(len(self.u), -1).T.astype(dtype)
        found = jnp.stack([jnp.asarray(column)[k] for column in columns])
        return found.reshape(self.u.shape[1:])


def _last(times: np.ndarray, t: Array) -> Array:
    """The place of the last of `times` that is not after t, the first where all are: by
    halves, which takes few operations however many there are."""
    k, most = jnp.asarray(0), len(times) - 1
    table = jnp.asarray(times)
    for power in reversed(range(math.ceil(math.log2(len(times))) if most else 0)):
        further = k + 2**power
        there = (further <= most) & (t >= table[jnp.minimum(further, most)])
        k = jnp.where(there, further, k)
    return k
