"""Linear state feedback, for plants that do not stay where they are."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import PyTree, RealArray
from ..plants import AbstractVectorPlant
from ._base import AbstractController

__all__ = ["StateFeedback"]

POLES = 0.8, 1.25  # the slowest and the fastest, over the bandwidth


class StateFeedback(AbstractController):
    """`u = hold + signal(t) - gain (x - centre)`, of the state x that it is fed.

    - `gain`, shape `(m, n)`, units of the input per unit of x; `centre`, shape `(n,)`;
      `hold`, shape `(m,)`, the input there;
    - `signal(t)`: what is added to the input, for instance to excite, shape `()` or `(m,)`.

    **Raises:** `ValueError` for shapes that do not fit.
    """

    gain: Float[Array, "m n"] = eqx.field(converter=real)
    centre: Float[Array, " n"] = eqx.field(converter=real)
    hold: Float[Array, " m"] = eqx.field(converter=real)
    signal: Callable[[Float[Array, ""]], PyTree]

    def __check_init__(self) -> None:
        wanted = jnp.shape(self.hold) + jnp.shape(self.centre)
        if jnp.shape(self.gain) != wanted:
            raise ValueError(
                f"Argument `gain` must have shape {wanted}, beside `hold` and `centre`, "
                f"but got {jnp.shape(self.gain)}."
            )

    @classmethod
    def of_plant(
        cls,
        plant: AbstractVectorPlant,
        bandwidth: float,
        signal: Callable[[Float[Array, ""]], Any],
        centre: Float[Array, " n"] | None = None,
    ) -> "StateFeedback":
        """Holds a `plant` at the state `centre`, shape `(n,)`, by default that in which it
        starts, with every pole near `-bandwidth` (rad/s), and adds a `signal`."""
        positive("bandwidth", bandwidth, "rad/s")
        x = plant.initial() if centre is None else real(centre)
        hold = plant.balance(x)
        by_x, by_u = jax.jacfwd(plant.vector_field, (1, 2))(jnp.zeros(()), x, hold)
        sizes = np.array([each.high - each.low for each in plant.moving().values()])
        pushes = np.array([each.high - each.low for each in plant.inputs.values()])
        A = np.asarray(by_x) * sizes / sizes[:, None] / bandwidth
        B = np.asarray(by_u) * pushes / sizes[:, None] / bandwidth
        poles = -np.geomspace(*POLES, len(A))
        import scipy.signal  # heavy to import

        found: Any = scipy.signal.place_poles(A, B, poles)
        return cls(found.gain_matrix * pushes[:, None] / sizes, x, hold, signal)

    def init(self, fed: PyTree) -> PyTree:
        del fed

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del t, state, fed

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del state
        back = jnp.sum(self.gain * (fed - self.centre), axis=1)
        return self.hold + self.signal(t) - back
