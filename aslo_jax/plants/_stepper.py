"""The two-phase permanent-magnet stepper motor (paper, O6)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._typing import RealArray
from ._machine import no_load
from ._magnet import AbstractRoundMachine


class Stepper(AbstractRoundMachine):
    """A two-phase PM or hybrid stepper: input u the phase voltages (V), output the phase
    currents (A), hidden part the phase fluxes (Wb), each of shape `(2,)`. It is a PMSM with
    magnet flux `torque_constant / pole_pairs`.

    - `resistance` (ohm) and `inductance` (H) of a phase;
    - `torque_constant`: the largest torque of one phase per ampere (N m/A), which is also
      its largest back-EMF per speed (V s/rad);
    - `pole_pairs`: the teeth of the rotor, a quarter of the full steps per turn;
    - `inertia` (kg m^2), `friction` (N m s/rad), `load(t)` (N m);
    - `detent_torque`: amplitude of the torque without current (N m), which goes through
      four periods per tooth;
    - `torque_factor`: 1, the machine having two phases.

    Source: Ortega, Loria, Nicklasson, Sira-Ramirez 1998, Example 9.9,
    doi:10.1007/978-1-4471-3603-3.
    """

    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    torque_constant: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    detent_torque: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.0)

    def __check_init__(self) -> None:
        positive("torque_constant", self.torque_constant, "N m/A")

    @classmethod
    def bodson(cls, **changes: Any) -> "Stepper":
        """The motor of Bodson, Chiasson, Novotnak, Rekowski, "High-performance nonlinear
        feedback control of a permanent magnet stepper motor", IEEE Trans. Control Systems
        Technology 1(1), 1993, doi:10.1109/87.221347; detent torque not given there.
        `changes` replace or add arguments."""
        table: dict[str, Any] = dict(
            resistance=0.55,
            inductance=1.5e-3,
            torque_constant=0.19,
            pole_pairs=50,
            inertia=4.5e-5,
            friction=8e-4,
        )
        return cls(**(table | changes))

    @property
    def magnet_flux(self) -> Float[Array, ""]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What the magnet links with a phase (Wb)."""
        return self.torque_constant / self.pole_pairs

    def detent(self, theta: RealArray) -> RealArray:
        return -self.detent_torque * jnp.sin(4.0 * theta)
