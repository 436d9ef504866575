"""The steady-state Kalman filter of a linear system."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from .._checks import is_concrete, optional_real, real, stable
from .._filters import LinearSystem, Switched
from .._realise import Pass
from .._signals import vector
from .._typing import PyTree
from ._base import AbstractObserver, Estimate

__all__ = ["SteadyStateKalman"]


class SteadyStateKalman(AbstractObserver):
    """`x' = A x + B u + gain (y - C x)` with the constant gain of the settled filter.

    - `A`, shape `(n, n)`, in 1/s; `B`, shape `(n, m)`; `C`, shape `(p, n)`;
    - `gain`, shape `(n, p)`; [`design`][] computes it from the noise intensities;
    - `select`, shape `(k, n)`: the estimate is `select @ x`, by default all of x;
    - `initial`: x at the first instant, shape `(n,)`; zero by default.

    The certificate is 1.

    Source: Kalman and Bucy 1961, doi:10.1115/1.3658902.
    """

    A: Float[Array, "n n"] = eqx.field(converter=real)
    B: Float[Array, "n m"] = eqx.field(converter=real)
    C: Float[Array, "p n"] = eqx.field(converter=real)
    gain: Float[Array, "n p"] = eqx.field(converter=real)
    select: Float[Array, "k n"] | None = eqx.field(converter=optional_real, default=None)
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        if is_concrete(self.A, self.C, self.gain):
            stable("A - gain C", self.A - self.gain @ self.C)

    @classmethod
    def design(
        cls,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        input_intensity: ArrayLike | float,
        measurement_intensity: ArrayLike | float,
        select: ArrayLike | None = None,
    ) -> "SteadyStateKalman":
        """The filter for white noise on the input and on the measurement, of the given
        two-sided intensities, shapes `(m, m)` and `(p, p)` (unit squared times second)."""
        import scipy.linalg

        A, B, C = (np.atleast_2d(np.asarray(x, float)) for x in (A, B, C))
        W = np.atleast_2d(np.asarray(input_intensity, float))
        V = np.atleast_2d(np.asarray(measurement_intensity, float))
        picked = None if select is None else np.asarray(select, float)
        P = scipy.linalg.solve_continuous_are(A.T, C.T, B @ W @ B.T, V)
        return cls(A, B, C, P @ C.T @ np.linalg.inv(V), picked)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        u = vector("u", u, self.B.shape[1])
        y = vector("y", y, self.C.shape[0])
        drive = self.B @ u + F.trust * (self.gain @ y)
        start = jnp.zeros_like(drive) if self.initial is None else self.initial
        law = LinearSystem(self.A - self.gain @ self.C)
        law = Switched(law, LinearSystem(self.A), F.missing)
        x = F.evolve(law, drive, start, "kalman")
        value = x if self.select is None else self.select @ x
        return Estimate(value, jnp.ones_like(value[0]), jnp.asarray(False))
