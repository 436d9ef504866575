"""The reduced-order Luenberger observer of a linear system."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import is_concrete, optional_real, positive, real, stable
from .._filters import LinearSystem, Switched
from .._realise import Pass
from .._signals import vector
from .._typing import PyTree
from ._base import AbstractObserver, Estimate

__all__ = ["ReducedLuenberger"]


class ReducedLuenberger(AbstractObserver):
    """Estimates the unmeasured states of `x' = A x + B u`, whose first `p` states are
    measured, `y = x[:p]`.

    - `A`, shape `(n, n)`, in 1/s; `B`, shape `(n, m)`;
    - `gain`, shape `(n - p, p)`: the error obeys `e' = (A22 - gain A12) e`;
    - `initial`: the estimate at the first instant, shape `(n - p,)`; by default the inner
      state starts at zero, as in the paper.

    The estimate has shape `(n - p,)`; its certificate is 1.

    Source: paper, eq. (lueobs).

    **Raises:** `ValueError` for a `gain` whose shape does not fit `A`.
    """

    A: Float[Array, "n n"] = eqx.field(converter=real)
    B: Float[Array, "n m"] = eqx.field(converter=real)
    gain: Float[Array, "k p"] = eqx.field(converter=real)
    initial: Float[Array, " k"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        if jnp.ndim(self.gain) != 2 or sum(jnp.shape(self.gain)) != jnp.shape(self.A)[-1]:
            raise ValueError(
                "Argument `gain` must have shape (n - p, p) for n states of which p are "
                f"measured, but got {jnp.shape(self.gain)} for n = {jnp.shape(self.A)[-1]}."
            )
        if is_concrete(self.A, self.gain):
            stable("A22 - gain A12", self._error_matrix())

    @classmethod
    def of_chain(cls, order: int, rate: Float[Array, ""] | float) -> "ReducedLuenberger":
        """For the chain of `order` integrators, every pole at `-rate` (rad/s)."""
        pole, k = real(rate), order - 1
        positive("rate", pole, "rad/s")
        gain = jnp.stack([math.comb(k, j) * pole**j for j in range(1, k + 1)])
        return cls(jnp.eye(order, k=1), jnp.eye(order)[:, -1:], gain[:, None])

    def _error_matrix(self) -> Array:
        p = self.gain.shape[1]
        return self.A[p:, p:] - self.gain @ self.A[:p, p:]

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        u = vector("u", u, self.B.shape[1])
        y = vector("y", y, self.gain.shape[1])
        p, L = self.gain.shape[1], self.gain
        error = self._error_matrix()
        A, B = self.A, self.B
        drive = (error @ L + A[p:, :p] - L @ A[:p, :p]) @ y + (B[p:] - L @ B[:p]) @ u
        start = jnp.zeros_like(drive) if self.initial is None else self.initial - L @ y
        law, inside = LinearSystem(error), jnp.sign(F.weight)
        law = Switched(law, LinearSystem(A[p:, p:]), inside == 0)
        # Without y the state is the estimate itself, x' = A22 x + A21 y + B2 u.
        drive = jnp.where(inside == 0, A[p:, :p] @ y + B[p:] @ u, drive)
        name = F.apart("luenberger", lambda: -(L @ y), whole=True)
        value = F.continued(name, law, drive, start) + inside * (L @ y)
        return Estimate(value, jnp.ones_like(value[0]), jnp.asarray(False))
