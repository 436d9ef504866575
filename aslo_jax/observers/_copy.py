"""The full-order Luenberger observer of any model: a copy of it, corrected."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import is_concrete, positive, real
from .._filters import AbstractLaw
from .._realise import Pass
from .._runge_kutta import runge_kutta
from .._typing import PyTree, RealArray
from ..plants import AbstractVectorPlant
from ._base import AbstractObserver, Estimate
from ._models import AbstractModel
from ._plant_model import PlantModel, linearised

__all__ = ["Luenberger"]

POLES = 0.8, 1.25  # the slowest and the fastest, over the bandwidth
UNOBSERVABLE = 1e-8  # relative singular value of the scaled observability matrix


class _Copy(AbstractLaw):
    """`x' = f(x, u) + gain (y - h(x))`, driven by `(u, y)`; sampled, u is held and y goes
    straight from one sample to the next."""

    model: AbstractModel
    gain: Float[Array, "n p"]
    trust: Float[Array, ""] | float = 1.0

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        u, y = v
        seen = self.trust * (y - self.model.output(X))
        return self.model.drift(X, u) + jnp.sum(self.gain * seen, axis=1)

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.gain.dtype)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        h, (u, y0), (_, y1) = coefficients, v0, v1

        def rate(t, X):
            return self.flow(X, (u, y0 + (t / h) * (y1 - y0)))

        return runge_kutta(rate, jnp.zeros_like(h), X, h)


class Luenberger(AbstractObserver):
    """A copy of the model that is corrected by what is measured: `x' = f(x, u) +
    gain (y - h(x))`, the peer of those that solve for x.

    - `model`: `drift(x, u)`, `output(x)`, and what of x is the estimate, `select(x)`;
    - `gain`, shape `(n, p)`, in units of x per second and unit of y;
    - `initial`: x at the first instant, shape `(n,)`.

    Its certificate is 1: it knows nothing of its error. Sampled, it takes a step of Runge
    and Kutta's fourth order from sample to sample, so that its poles must be slower than
    twice the sampling rate.

    Source: Luenberger 1971, doi:10.1109/TAC.1971.1099826.

    **Raises:** `ValueError` for a `gain` whose shape does not fit `initial`.
    """

    model: AbstractModel
    gain: Float[Array, "n p"] = eqx.field(converter=real)
    initial: Float[Array, " n"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        if jnp.ndim(self.gain) != 2 or jnp.shape(self.gain)[:1] != jnp.shape(self.initial):
            raise ValueError(
                "Argument `gain` must have shape (n, p) beside an `initial` of shape (n,), "
                f"but got {jnp.shape(self.gain)} and {jnp.shape(self.initial)}."
            )

    @classmethod
    def of_plant(
        cls,
        plant: AbstractVectorPlant,
        bandwidth: Float[Array, ""] | float,
        initial: Float[Array, " s"] | None = None,
    ) -> "Luenberger":
        """For a plant and its unknown parameters, which are taken to be those of `plant` at
        the start: every pole near `-bandwidth` (rad/s) where the plant is in the state
        `initial`, shape `(s,)`, by default its own, and held there.

        **Raises:** `ValueError` where the plant is not observable there, and for a
        `bandwidth` that is not positive, and where it or the plant is being traced.
        """
        if not is_concrete(bandwidth, *jax.tree.leaves(plant)):
            raise ValueError(
                "Arguments `plant` and `bandwidth` must hold numbers, but are being "
                "traced; make the observer before."
            )
        positive("bandwidth", bandwidth, "rad/s")
        model = PlantModel(plant)
        state = plant.initial() if initial is None else real(initial)
        x = model.joined(state)
        A, C = linearised(model, plant.balance(state), x)
        # Of entries over their ranges and time over that of the bandwidth.
        sizes = np.asarray(model.spans())
        seen = np.array([0.5 * (s.high - s.low) for s in plant.outputs.values()])
        A = A * sizes / sizes[:, None] / bandwidth
        C = C * sizes / seen[:, None]
        _refuse_unobservable(A, C)
        poles = -np.geomspace(*POLES, len(A))
        import scipy.signal  # heavy to import

        found: Any = scipy.signal.place_poles(A.T, C.T, poles)
        placed = found.gain_matrix.T
        return cls(model, bandwidth * placed * sizes[:, None] / seen, x)

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.model.signals_of(self.initial.shape[0])

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        law = _Copy(self.model, self.gain, F.trust)
        x = F.evolve(law, (u, jnp.atleast_1d(y)), self.initial, "copy")
        value = self.model.select(x)
        return Estimate(value, jnp.ones_like(value[0]), jnp.asarray(False))


def _refuse_unobservable(A: np.ndarray, C: np.ndarray) -> None:
    size = max(np.abs(A).max(), 1e-300)  # of time, so that powers stay comparable
    rows = [C]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A / size)
    singular = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    if singular[-1] <= UNOBSERVABLE * singular[0]:
        raise ValueError(
            "Argument `plant` must be observable where it is held at `initial`, but it is "
            "not, so no constant gain places all poles; take another `initial`, or "
            "`ExtendedKalman.of_plant`."
        )
