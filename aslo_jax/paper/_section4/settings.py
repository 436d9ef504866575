"""The settings of the paper's section 4, and the observers that its claims are about."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._checks import real
from ..._filters import LowPass
from ..._typing import FilterStart
from ...control import AbstractController
from ...control._tracking import BallBeamTracking, MechanicalFeedback, Tracking
from ...observers import AbstractObserver, velocity_observer
from ...plants import (
    AbstractMechanicalSystem,
    BallBeam,
    MechanicalState,
    MechanicalSystem,
    RoboticLeg,
)
from .propositions import Proposition4, Proposition5, VelocityAsymptotic

MASS, BODY = 2.0, 3.0  # m1 (kg) and m2 (kg m^2) of the leg
SWING = 0.2  # of its length about 1 m, and of the ball about the middle (m)
BEAM = 1.2  # length of the beam (m)
RATE = 5.0  # lambda (rad/s)
GAINS = 2.0, 10.0  # gamma of the A-ASLO below and above lambda (rad/s)
SPAN = 8.0  # of the continuous runs (s)
SETTLED = 6.0  # when the transients of the printed start are below 1e-11 (s)
FRICTION = 0.5  # of every coordinate (N s/m, N m s/rad)
INTERVAL, STEPS = 1e-3, 2000  # of the sampled loops (s), and how many of them
PARAMETER_ERROR = 0.05  # of masses, gravity and length


class Mechanism(NamedTuple):
    """A mechanism in closed loop.

    - `system`; `controller(system)`: the tracking controller made for it;
    - `start`: the first state, and `spread`: how far the first states of the sampled
      records lie about it, positions and velocities;
    - `ranges`: what the encoder of each coordinate spans, a turn (rad) or a length (m);
    - `parameters`: those that may be wrong by 5 %, and in which direction when all are;
    - `units`: of each velocity.
    """

    system: AbstractMechanicalSystem
    controller: Callable[[AbstractMechanicalSystem], AbstractController]
    start: MechanicalState
    spread: MechanicalState
    ranges: tuple[float, ...]
    parameters: dict[str, int]
    units: tuple[str, ...]

    @property
    def coordinates(self) -> int:
        return len(self.units)


def sway(t: Float[Array, ""]) -> Float[Array, " 2"]:
    """Length (m) and angle (rad) wanted of the leg."""
    return jnp.stack([1.0 + SWING * jnp.sin(t), 0.6 * jnp.sin(1.3 * t)])


def roll(t: Float[Array, ""]) -> Float[Array, ""]:
    """Position (m) wanted of the ball."""
    return SWING * jnp.sin(0.5 * t)


def _leg_control(system):
    return Tracking(system, sway, (0, 1), 4.0)


def _ball_control(system):
    return BallBeamTracking(system, roll)


def state(position: list[float], velocity: list[float]) -> MechanicalState:
    """A state in the precision of the moment."""
    return MechanicalState(jnp.asarray(position, float), jnp.asarray(velocity, float))


def leg() -> Mechanism:
    """The robotic leg; the paper prints no numbers."""
    return Mechanism(
        RoboticLeg(m1=jnp.asarray(MASS), m2=jnp.asarray(BODY)),
        _leg_control,
        state([1.0, 0.4, -0.3], [0.2, 1.0, -0.5]),
        state([0.2, 0.3, 0.3], [0.3, 0.5, 0.5]),
        (2.0, 2 * np.pi, 2 * np.pi),
        {"m1": 1, "m2": -1},
        ("m/s", "rad/s", "rad/s"),
    )


def ball() -> Mechanism:
    """The ball and beam; the paper prints no numbers."""
    return Mechanism(
        BallBeam(length=jnp.asarray(BEAM)),
        _ball_control,
        state([0.1, 0.3], [-0.2, 0.6]),
        state([0.1, 0.2], [0.2, 0.3]),
        (BEAM, 2 * np.pi),
        {"length": 1, "gravity": -1},
        ("m/s", "rad/s"),
    )


def true_feedback(y, x, estimates) -> MechanicalFeedback:
    """The true positions and velocities: no contender has a part in the motion."""
    del y, estimates
    return MechanicalFeedback(x.position, x.velocity)


class Friction(eqx.Module):
    """Friction of the leg (N s/m, N m s/rad): for a `weight` of 0 the same constant on
    every coordinate, for 1 one that varies with its length."""

    weight: Float[Array, ""] = eqx.field(converter=real)

    def __call__(self, q: Float[Array, " 3"]) -> Float[Array, " 3"]:
        first, second = 0.2 + 0.1 * q[0] ** 2, 0.3 + 0.2 * jnp.cos(q[0])
        varying = jnp.stack([first, second, 0.1 + 0.0 * q[0]])
        return self.weight * varying + (1.0 - self.weight) * FRICTION


def leg_with_friction(weight: Float[Array, ""] | float) -> MechanicalSystem:
    """The leg with [`Friction`][]."""
    mechanism = leg()
    system = mechanism.system
    return MechanicalSystem(
        system.inertia,
        None,
        system.input_matrix,
        position=mechanism.start.position,
        friction=Friction(weight),
    )


def aslo(system: AbstractMechanicalSystem, start: FilterStart = "exact", **settings):
    """The library's ASLO of all velocities, lambda = 5 rad/s."""
    return velocity_observer(system, LowPass(RATE), start=start, **settings)


def a_aslo(
    observer: AbstractObserver, system: AbstractMechanicalSystem, gains: tuple[float, ...]
) -> AbstractObserver[Any]:
    """P2 of Props 4 and 5 on an ASLO, for each of `gains` (rad/s)."""
    return VelocityAsymptotic(observer, system, jnp.array(gains))


class Printed(NamedTuple):
    """What the claims of section 4 are about."""

    aslo: Callable[..., AbstractObserver] = aslo
    a_aslo: Callable[..., AbstractObserver] = a_aslo
    leg: Callable[..., AbstractObserver] = Proposition4
    ball: Callable[..., AbstractObserver] = Proposition5
