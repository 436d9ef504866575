"""What is derived from a mechanical system, whose rule is its structure."""

import dataclasses
from typing import Any

from jaxtyping import Array, Float

from .._filters import AbstractFilter
from .._structure import Region, Structure, decay_rate, structure_of
from ..observers import AbstractObserver, velocity_observer
from ..plants import AbstractMechanicalSystem


@dataclasses.dataclass(frozen=True, eq=False)
class DerivedVelocities:
    """The observer that was derived from a mechanical system: its velocities, one after the
    other, each from a relation of its momentum.

    - `system`: the system; `structure`: the form of its observer; `region`: where that was
      looked at, a pair (low, high) of coordinates, `None` for the default;
    - `slowest`: the rate (rad/s) that a low-pass filter must be above: friction over
      inertia where it varies with position, else zero.
    """

    system: AbstractMechanicalSystem
    structure: Structure
    region: Region | None
    slowest: float

    @property
    def states(self) -> tuple[str, ...]:
        """The names of what is found, `qdot1` and so on."""
        return tuple(f"qdot{j + 1}" for j in range(len(self.structure.friction)))

    def observer(
        self,
        filter: AbstractFilter,
        *,
        gain: Float[Array, ""] | float | None = None,
        initial: Any = None,
        **settings: Any,
    ) -> AbstractObserver:
        """The observer of the velocities, as [`velocity_observer`][] makes it.

        - `filter`: that of the Swapping Lemma;
        - `gain` (rad/s): makes it an A-ASLO of every momentum; by default none;
        - `initial`: the velocities before the first certified instant, shape `(n,)`;
        - `settings`: `completion`, `guard` and `start` of [`AlgebraicObserver`][].
        """
        return velocity_observer(
            self.system,
            filter,
            gain=gain,
            initial=initial,
            region=self.region,
            form=self.structure,
            **settings,
        )

    def plant(self) -> AbstractMechanicalSystem:
        """The system as a plant."""
        return self.system

    def __str__(self) -> str:
        slowest = "any" if not self.slowest else f"above {self.slowest:.4g} rad/s"
        return f"{self.structure}\ncutoff of the filter: {slowest}"


def derive_velocities(
    system: AbstractMechanicalSystem, region: Region | None
) -> DerivedVelocities:
    """What is derived from a mechanical `system` that moves in a `region`.

    **Raises:** [`StructureError`][] where it is not of the class.
    """
    structure = structure_of(system, region)
    varying = [j for j, kind in enumerate(structure.friction) if kind == "varying"]
    decays = (float(decay_rate(system, j, region)[1].max()) for j in varying)
    return DerivedVelocities(system, structure, region, max(decays, default=0.0))
