"""The wound-rotor induction machine (paper, section 3.2)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import positive, real
from .._module import Module
from .._relations import Quadratic
from .._typing import RealArray
from ._machine import AbstractMachine, Inductance, direction, no_load

WINDINGS = {"stator": slice(0, 2), "rotor": slice(2, 4)}


class WindingFluxRelation(Module):
    """`|phi_k - L_k i_k|^2 = L_sr^2 |i_other|^2`: the flux phi_k (Wb), shape `(2,)`, of the
    stator or the rotor of a wound-rotor induction machine, in the frame of that winding.

    - `winding`: `"stator"` or `"rotor"`;
    - `resistance` (ohm) and `inductance` (H) of that winding; `mutual_inductance` L_sr (H).

    u and y are those of [`WRIM`][]. The paper prints L_s for both windings; the rotor's
    relation holds with L_r.

    Source: paper, Prop. 3 and App. C; theory, section 2.

    **Raises:** `ValueError` for another `winding`.
    """

    winding: str = eqx.field(static=True)
    resistance: Float[Array, ""] = eqx.field(converter=real)
    inductance: Float[Array, ""] = eqx.field(converter=real)
    mutual_inductance: Float[Array, ""] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        if self.winding not in WINDINGS:
            raise ValueError(
                f'Argument `winding` must be "stator" or "rotor", but got {self.winding!r}.'
            )

    def __call__(self, u: Float[Array, " m"], y: Float[Array, " 4"]) -> Quadratic:
        L, L_sr, own = self.inductance, self.mutual_inductance, WINDINGS[self.winding]
        other = WINDINGS["rotor" if self.winding == "stator" else "stator"]
        yk, yo = y[own], y[other]
        return Quadratic(
            Q=1.0 / L,
            c=yk,
            d=0.5 * (L_sr**2 * jnp.sum(yo * yo) / L - L * jnp.sum(yk * yk)),
            z=winding_voltages(u)[own] - self.resistance * yk,
        )


def winding_voltages(u: Float[Array, " m"]) -> Float[Array, " 4"]:
    """`G u`: stator and rotor voltages (V), those of the rotor zero unless given."""
    return u if u.shape[0] == 4 else jnp.concatenate([u, jnp.zeros_like(u)])


class WRIM(AbstractMachine):
    """A wound-rotor induction machine. Four windings: two of the stator in its frame, then
    two of the rotor in its own, which turns by the electrical angle. Output the currents
    (A) and hidden part the fluxes (Wb), each of shape `(4,)`. Input the stator voltage (V),
    shape `(2,)`, with shorted slip rings, or stator and rotor voltage, shape `(4,)`.

    - `stator_resistance`, `rotor_resistance` (ohm), `stator_inductance`,
      `rotor_inductance`, `mutual_inductance` (H), of which the square must be below the
      product of the others; `pole_pairs`; `inertia` (kg m^2), `friction` (N m s/rad);
    - `load(t)`: the load torque (N m) at time t (s);
    - `torque_factor`: 3/2 in the amplitude-invariant convention; 1 as the paper prints it.

    Rotor quantities may be the rotor's own or referred to the stator, all in one way.

    Source: paper, eqs. (dotlam) and (lambda).
    """

    stator_resistance: Float[Array, ""] = eqx.field(converter=real)
    rotor_resistance: Float[Array, ""] = eqx.field(converter=real)
    stator_inductance: Float[Array, ""] = eqx.field(converter=real)
    rotor_inductance: Float[Array, ""] = eqx.field(converter=real)
    mutual_inductance: Float[Array, ""] = eqx.field(converter=real)
    pole_pairs: int = eqx.field(static=True)
    inertia: Float[Array, ""] = eqx.field(converter=real)
    friction: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    load: Callable[[Float[Array, ""]], Float[Array, ""]] = no_load
    torque_factor: Float[Array, ""] = eqx.field(converter=real, default=1.5)

    def __check_init__(self) -> None:
        positive("stator_resistance", self.stator_resistance, "ohm")
        positive("rotor_resistance", self.rotor_resistance, "ohm")
        positive("stator_inductance", self.stator_inductance, "H")
        positive("rotor_inductance", self.rotor_inductance, "H")
        positive("mutual_inductance", self.mutual_inductance, "H")
        leakage = self.stator_inductance * self.rotor_inductance - self.mutual_inductance**2
        positive(
            "stator_inductance * rotor_inductance - mutual_inductance^2", leakage, "H^2"
        )

    @classmethod
    def dfig_2mw(cls, **changes: Any) -> "WRIM":
        """The 2 MW, 690 V, 50 Hz generator of Abad, Lopez, Rodriguez, Marroyo, Iwanski,
        "Doubly Fed Induction Machine", Wiley-IEEE Press, 2011, doi:10.1002/9781118104965;
        rotor referred to the stator. `changes` replace or add arguments."""
        table: dict[str, Any] = dict(
            stator_resistance=2.6e-3,
            rotor_resistance=2.9e-3,
            stator_inductance=2.587e-3,
            rotor_inductance=2.587e-3,
            mutual_inductance=2.5e-3,
            pole_pairs=2,
            inertia=127.0,
            friction=1e-3,
        )
        return cls(**(table | changes))

    def inductances(self, theta: RealArray) -> Inductance:
        Ls, Lr, zero = self.stator_inductance, self.rotor_inductance, 0.0 * theta
        a, b = self.mutual_inductance * direction(theta)
        return jnp.stack(
            [
                jnp.stack([Ls + zero, zero, a, -b]),
                jnp.stack([zero, Ls + zero, b, a]),
                jnp.stack([a, b, Lr + zero, zero]),
                jnp.stack([-b, a, zero, Lr + zero]),
            ]
        )

    def magnet(self, theta: RealArray) -> RealArray:
        return jnp.zeros(4, theta.dtype)

    def flux_rate(self, u: RealArray, y: RealArray) -> RealArray:
        Rs, Rr = self.stator_resistance, self.rotor_resistance
        return winding_voltages(u) - jnp.stack([Rs, Rs, Rr, Rr]) * y

    def detent(self, theta: RealArray) -> RealArray:
        return jnp.zeros_like(theta)

    def flux_relation(self, winding: str) -> WindingFluxRelation:
        """The quadratic relation of the flux of the `"stator"` or the `"rotor"`."""
        stator = winding == "stator"
        resistance = self.stator_resistance if stator else self.rotor_resistance
        inductance = self.stator_inductance if stator else self.rotor_inductance
        return WindingFluxRelation(winding, resistance, inductance, self.mutual_inductance)
