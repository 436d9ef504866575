"""`[machine]` of a study: that of a machine description, and what acts on it."""

import abc
from typing import Annotated, Any, ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from ...machines.ball_beam import BallBeamTable
from ...machines.base import Positive, Table, key
from ...machines.magnetic_bearing import MagneticBearingTable
from ...machines.pmsm import PMSMTable
from ...machines.robotic_leg import RoboticLegTable
from ...machines.wrim import WRIMTable
from ...plants import (
    PMSM,
    WRIM,
    AbstractPlant,
    BallBeam,
    IntegratorChain,
    MagneticBearing,
    RoboticLeg,
)
from .signals import NoLoad, Numbers, WaveTable

NonNegative = Annotated[float, Field(ge=0)]


class AbstractMachineTable(Table, abc.ABC):
    """A plant, the state that it starts in, and what is estimated of it.

    - `entries`: the names of what is estimated, and `units` of each.
    """

    entries: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def plant(self) -> AbstractPlant:
        """The plant."""

    @abc.abstractmethod
    def start(self, plant: AbstractPlant) -> Any:
        """The first state; `None` for the plant's own."""


class DoubleIntegrator(AbstractMachineTable):
    """`x1' = x2, x2' = u, y = x1`."""

    kind: Literal["double_integrator"] = key("the kind of machine")
    position: float = key("position at the start", "m", default=0.0)
    speed: float = key("speed at the start", "m/s", default=0.0)

    entries = ("speed",)
    units = ("m/s",)

    def plant(self) -> AbstractPlant:
        return IntegratorChain(2)

    def start(self, plant: AbstractPlant) -> Any:
        del plant
        return jnp.array([self.position, self.speed], float)


class MachineStart(Table):
    """The state in which a machine starts; what is left out is that of the plant."""

    flux: Numbers | None = key("flux of the windings", "Wb", default=None)
    speed: float | None = key("mechanical speed", "rad/s", default=None)
    angle: float | None = key("mechanical angle", "rad", default=None)


class PMSMMachine(PMSMTable, AbstractMachineTable):
    """A surface-mounted PMSM with a load."""

    friction: NonNegative = key("viscous friction", "N m s/rad", default=0.0)
    load: WaveTable = key("load torque (N m)", default=NoLoad)
    initial: MachineStart = key("the first state", default=MachineStart())

    entries = ("flux_alpha", "flux_beta")
    units = ("Wb", "Wb")

    def plant(self) -> AbstractPlant:
        table = self.model_dump(exclude={"kind", "load", "initial"})
        return PMSM(**table, load=self.load.signal())

    def start(self, plant: AbstractPlant) -> Any:
        return _changed(plant, self.initial)


class WRIMMachine(WRIMTable, AbstractMachineTable):
    """A wound-rotor induction machine with a load."""

    friction: NonNegative = key("viscous friction", "N m s/rad", default=0.0)
    load: WaveTable = key("load torque (N m)", default=NoLoad)
    initial: MachineStart = key("the first state", default=MachineStart())

    entries = ("flux_s_alpha", "flux_s_beta", "flux_r_alpha", "flux_r_beta")
    units = ("Wb",) * 4

    def plant(self) -> AbstractPlant:
        table = self.model_dump(exclude={"kind", "load", "initial"})
        return WRIM(**table, load=self.load.signal())

    def start(self, plant: AbstractPlant) -> Any:
        return _changed(plant, self.initial)


class MotionStart(Table):
    """The state in which a mechanism starts; what is left out is that of the plant."""

    position: list[float] | None = key("coordinates (m, rad)", default=None)
    velocity: list[float] | None = key("their rates (m/s, rad/s)", default=None)


class RoboticLegMachine(RoboticLegTable, AbstractMachineTable):
    """An extensible leg on a body."""

    initial: MotionStart = key("the first state", default=MotionStart())

    entries = ("length", "leg", "body")
    units = ("m/s", "rad/s", "rad/s")

    def plant(self) -> AbstractPlant:
        return RoboticLeg(**self.model_dump(exclude={"kind", "initial"}))

    def start(self, plant: AbstractPlant) -> Any:
        return _changed(plant, self.initial)


class BallBeamMachine(BallBeamTable, AbstractMachineTable):
    """A ball on a beam."""

    initial: MotionStart = key("the first state", default=MotionStart())

    entries = ("ball", "beam")
    units = ("m/s", "rad/s")

    def plant(self) -> AbstractPlant:
        return BallBeam(**self.model_dump(exclude={"kind", "initial"}))

    def start(self, plant: AbstractPlant) -> Any:
        return _changed(plant, self.initial)


class BearingStart(Table):
    """The state in which a bearing starts; what is left out is that of the plant."""

    flux: Numbers | None = key("flux of the coils", "Wb", default=None)
    position: float | None = key("position of the body", "m", default=None)
    velocity: float | None = key("velocity of the body", "m/s", default=None)


class MagneticBearingMachine(MagneticBearingTable, AbstractMachineTable):
    """One axis of a magnetic bearing under an outer force."""

    bias: Positive = key("current of both coils at the start", "A", default=1.0)
    force: WaveTable = key("outer force on the body (N)", default=NoLoad)
    initial: BearingStart = key("the first state", default=BearingStart())

    entries = ("flux_1", "flux_2", "position", "velocity")
    units = ("Wb", "Wb", "m", "m/s")

    def plant(self) -> AbstractPlant:
        table = self.model_dump(exclude={"kind", "resistance", "force", "initial"})
        resistance = np.asarray(self.resistance, float)
        return MagneticBearing(resistance, **table, force=self.force.signal())

    def start(self, plant: AbstractPlant) -> Any:
        return _changed(plant, self.initial)


def _changed(plant: AbstractPlant, table: Table) -> Any:
    """The plant's first state with what the table gives in its place."""
    given = {k: v for k, v in table.model_dump().items() if v is not None}
    if not given:
        return None
    state = plant.initial()
    for name, value in given.items():
        old = getattr(state, name)
        new = jnp.asarray(value, float)
        if new.shape not in ((), old.shape):
            raise ValueError(
                f"`machine.initial.{name}` must hold {old.size} numbers, but is {value!r}"
            )
        new = jnp.broadcast_to(new, old.shape)
        state = eqx.tree_at(lambda s, n=name: getattr(s, n), state, new)
    return state


Machine = Annotated[
    DoubleIntegrator
    | PMSMMachine
    | WRIMMachine
    | RoboticLegMachine
    | BallBeamMachine
    | MagneticBearingMachine,
    Field(discriminator="kind"),
]
