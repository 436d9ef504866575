"""The surface-mounted permanent-magnet synchronous motor (paper, section 3.1)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import RealArray
from ._machine import no_load
from ._magnet import AbstractRoundMachine


class PMSM(AbstractRoundMachine):
    """A non-salient PMSM: input u the stator voltage (V), output the stator current (A),
    hidden part the stator flux (Wb), each of shape `(2,)`.

    - `resistance` (ohm), `inductance` (H), `magnet_flux` (Wb), `pole_pairs`, `inertia`
      (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention; 1 as the paper prints it.
      The paper's load of 3.5 N m takes 2.24 A with 3/2, and 3.36 A with 1, which is more
      than the 2.3 A of its Table 1.

    Source: paper, eqs. (sys) and (flucur).
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    magnet_flux: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    def __check_init__(self) -> None:
        positive("magnet_flux", self.magnet_flux, "Wb")

    @classmethod
    def bmp0701f(cls, **changes: Any) -> "PMSM":
        """The motor BMP0701F of the paper's Table 1; `changes` replace or add arguments."""
        table: dict[str, Any] = dict(
            resistance=8.875,
            inductance=40.03e-3,
            magnet_flux=0.2086,
            pole_pairs=5,
            inertia=60e-6,
        )
        return cls(**(table | changes))

    def detent(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(theta)
