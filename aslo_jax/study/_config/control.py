"""`[control]` of a study. Controllers are designed for the nominal plant and are fed its
true motion, so that no observer has a part in what it is judged by."""

import math
from typing import Annotated, Any, Literal

import equinox as eqx
import jax.numpy as jnp
from pydantic import Field

from ..._derive.plant import ModelPlant
from ..._module import Module
from ...control import (
    AbstractController,
    BallBeamTracking,
    BearingFeedback,
    FieldOriented,
    MagneticLevitation,
    MechanicalFeedback,
    MotorFeedback,
    OpenLoop,
    ReluctanceDrive,
    StateFeedback,
    Tracking,
)
from ...schema import Positive, Signal, Table, WaveTable, key


class MotorEncoder(Module):
    """The measured current with the true angle and speed."""

    pole_pairs: int = eqx.field(static=True)

    def __call__(self, y: Any, x: Any, estimates: dict[str, Any]) -> MotorFeedback:
        del estimates
        return MotorFeedback(y, self.pole_pairs * x.angle, x.speed)


class TrueMotion(Module):
    """The true positions and velocities."""

    def __call__(self, y: Any, x: Any, estimates: dict[str, Any]) -> MechanicalFeedback:
        del y, estimates
        return MechanicalFeedback(x.position, x.velocity)


class PositionSensor(Module):
    """The measured currents with the true fluxes, position and velocity."""

    def __call__(self, y: Any, x: Any, estimates: dict[str, Any]) -> BearingFeedback:
        del estimates
        return BearingFeedback(y, x.flux, x.position, x.velocity)


class TrueState(Module):
    """The true state of the plant."""

    def __call__(self, y: Any, x: Any, estimates: dict[str, Any]) -> Any:
        del y, estimates
        return x


class Nothing(Module):
    """A signal of `count` entries that are zero."""

    count: int = eqx.field(static=True)

    def __call__(self, t: Any) -> Any:
        return jnp.zeros(self.count, t.dtype)


class OpenLoopTable(Table):
    """An input that depends on time only."""

    kind: Literal["open_loop"] = key("the kind of control")
    signal: Signal = key("the input")

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        signal = self.signal.signal()
        held = plant.held(signal) if isinstance(plant, ModelPlant) else signal
        return OpenLoop(held), None


class FieldOrientedTable(Table):
    """Speed control of a PMSM."""

    kind: Literal["field_oriented"] = key("the kind of control")
    reference: WaveTable = key("mechanical speed (rad/s)")
    current_limit: Positive = key("largest current", "A")
    voltage_limit: Positive = key("largest voltage", "V", default=1e6)
    current_bandwidth: Positive = key("of the currents", "rad/s", default=2000.0)
    speed_bandwidth: Positive = key("of the speed", "rad/s", default=300.0)

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        settings = self.model_dump(exclude={"kind", "reference"})
        controller = FieldOriented(plant, self.reference.signal(), **settings)
        return controller, MotorEncoder(plant.pole_pairs)


class TrackingTable(Table):
    """Coordinates that follow a reference."""

    kind: Literal["tracking"] = key("the kind of control")
    reference: WaveTable = key("the wanted coordinates (m, rad)")
    tracked: list[int] = key("which coordinates, counted from 0")
    bandwidth: Positive = key("of the tracking", "rad/s", default=5.0)

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        controller = Tracking(
            plant, self.reference.signal(), tuple(self.tracked), self.bandwidth
        )
        return controller, TrueMotion()


class BallBeamTrackingTable(Table):
    """A ball that follows a reference."""

    kind: Literal["ball_beam_tracking"] = key("the kind of control")
    reference: WaveTable = key("the wanted position of the ball (m)")
    bandwidth: Positive = key("of the ball", "rad/s", default=1.5)
    beam_bandwidth: Positive = key("of the beam", "rad/s", default=12.0)
    tilt: Positive = key("the largest angle asked for", "rad", default=0.5)

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        settings = self.model_dump(exclude={"kind", "reference"})
        return BallBeamTracking(plant, self.reference.signal(), **settings), TrueMotion()


class LevitationTable(Table):
    """Levitation in a magnetic bearing."""

    kind: Literal["levitation"] = key("the kind of control")
    reference: WaveTable = key("the position (m)", default=WaveTable())
    bias: Positive = key("current of both coils at the centre", "A")
    bandwidth: Positive = key("of the position", "rad/s", default=200.0)
    flux_bandwidth: Positive = key("of the fluxes", "rad/s", default=2000.0)
    voltage_limit: Positive = key("of each coil", "V", default=1e6)
    ripple: float = key("amplitude of a voltage that excites", "V", default=0.0)
    ripple_frequency: Positive = key("its frequency", "rad/s", default=3000.0)
    ripple_phase: float = key("of coil 2 ahead of 1", "rad", default=math.pi / 2)

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        settings = self.model_dump(exclude={"kind", "reference"})
        reference = self.reference.signal()
        return MagneticLevitation(plant, reference, **settings), PositionSensor()


class NoControlTable(Table):
    """Of a plant without inputs."""

    kind: Literal["none"] = key("the kind of control")

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        return OpenLoop(Nothing(len(plant.inputs))), None


class StateFeedbackTable(Table):
    """A plant that is held where it starts."""

    kind: Literal["state_feedback"] = key("the kind of control")
    bandwidth: Positive = key("of its poles", "rad/s")
    signal: WaveTable = key("what is added to the input", default=WaveTable())

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        signal = self.signal.signal()
        return StateFeedback.of_plant(plant, self.bandwidth, signal), TrueState()


class ReluctanceDriveTable(Table):
    """Speed control of a synchronous reluctance motor."""

    kind: Literal["reluctance_drive"] = key("the kind of control")
    reference: WaveTable = key("mechanical speed (rad/s)")
    direct_current: Positive = key("current along the iron", "A")
    current_limit: Positive = key("largest current across it", "A")
    voltage_limit: Positive = key("largest voltage", "V", default=1e6)
    flux_bandwidth: Positive = key("of the fluxes", "rad/s", default=1000.0)
    speed_bandwidth: Positive = key("of the speed", "rad/s", default=50.0)

    def build(self, plant: Any) -> tuple[AbstractController, Any]:
        settings = self.model_dump(exclude={"kind", "reference"})
        controller = ReluctanceDrive(plant, self.reference.signal(), **settings)
        return controller, MotorEncoder(plant.pole_pairs)


Control = Annotated[
    OpenLoopTable
    | NoControlTable
    | StateFeedbackTable
    | ReluctanceDriveTable
    | FieldOrientedTable
    | TrackingTable
    | BallBeamTrackingTable
    | LevitationTable,
    Field(discriminator="kind"),
]
