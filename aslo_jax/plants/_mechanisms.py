"""Mechanisms whose velocities have an algebraic observer: those of the paper's section 4,
and others of their class."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import nonnegative, positive, real
from .._typing import PyTree, RealArray
from ._mechanical import AbstractMechanicalSystem, MechanicalState

__all__ = [
    "BallBeam",
    "CartOnArm",
    "Drive",
    "InertiaWheelPendulum",
    "RoboticLeg",
    "VariableLengthPendulum",
    "at_rest",
    "none_of",
]


def none_of(n: int):
    """A field of `n` zeros, made when an instance is."""
    return eqx.field(converter=real, default_factory=lambda: [0.0] * n)


class RoboticLeg(AbstractMechanicalSystem):
    """An extensible leg on a body: `q = (length (m), angle of the leg (rad), angle of the
    body (rad))`, `M = diag(m1, m1 q1^2, m2)`, `G = [[1, 0], [0, 1], [0, -1]]`. Input: the
    force along the leg (N) and the torque between leg and body (N m). The length must not
    go through zero.

    - `m1` (kg): the mass at the end of the leg; `m2` (kg m^2): the inertia of the body;
    - `damping`: constant friction of each coordinate (N s/m, N m s/rad), shape `(3,)`.

    Source: paper, section 4.1; Bullo, Lewis, "Geometric Control of Mechanical Systems",
    2005, doi:10.1007/978-1-4899-7276-7.
    """

    m1: Float[Array, ""] = eqx.field(converter=real)
    m2: Float[Array, ""] = eqx.field(converter=real)
    damping: Float[Array, " 3"] = none_of(3)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(False, True, True))

    def __check_init__(self) -> None:
        positive("m1", self.m1, "kg")
        positive("m2", self.m2, "kg m^2")
        nonnegative("damping", self.damping)

    def initial(self) -> PyTree:
        """At rest, 1 m long, at angle zero."""
        return at_rest(self.m1, [1.0, 0.0, 0.0])

    def inertia(self, q: RealArray) -> RealArray:
        return jnp.diag(jnp.stack([self.m1, self.m1 * q[0] ** 2, self.m2]))

    def potential(self, q: RealArray) -> RealArray:
        return jnp.zeros_like(q[0])

    def input_matrix(self, q: RealArray) -> RealArray:
        return jnp.asarray([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        return jnp.diag(self.damping)


class BallBeam(AbstractMechanicalSystem):
    """A ball on a beam that turns about its middle: `q = (position of the ball (m), angle
    of the beam (rad))`, `M = diag(1, length^2 + q1^2)`, `V = gravity q1 sin q2`. Input: the
    torque on the beam (N m). Masses are in units of the ball's.

    - `length` (m) of the beam, whose square is the beam's inertia; the ball is on it while
      `|q1| < length/2`; `gravity` (m/s^2);
    - `damping`: constant friction of each coordinate, shape `(2,)`.

    Source: paper, section 4.2; Hauser, Sastry, Kokotovic 1992, doi:10.1109/9.119645.
    """

    length: Float[Array, ""] = eqx.field(converter=real)
    gravity: Float[Array, ""] = eqx.field(converter=real, default=9.81)
    damping: Float[Array, " 2"] = none_of(2)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(False, True))

    def __check_init__(self) -> None:
        positive("length", self.length, "m")
        nonnegative("damping", self.damping)

    def initial(self) -> PyTree:
        """At rest in the middle of a level beam."""
        return at_rest(self.length, [0.0, 0.0])

    def inertia(self, q: RealArray) -> RealArray:
        one = jnp.ones_like(self.length)
        return jnp.diag(jnp.stack([one, self.length**2 + q[0] ** 2]))

    def potential(self, q: RealArray) -> RealArray:
        return self.gravity * q[0] * jnp.sin(q[1])

    def input_matrix(self, q: RealArray) -> RealArray:
        return jnp.asarray([[0.0], [1.0]], q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        return jnp.diag(self.damping)


class Drive(AbstractMechanicalSystem):
    """A drive of one degree of freedom, `q'' = -decay q' + gain u`, with q the angle of the
    shaft (rad): a motor whose current follows faster than its speed. Input: what drives it,
    for instance a voltage (V).

    - `decay` (1/s): friction and back-EMF over inertia, one over its time constant;
    - `gain` (rad/s^2 for one of the input), of either sign.

    Its inertia is taken as one, so that forces are accelerations.
    """

    decay: Float[Array, ""] = eqx.field(converter=real)
    gain: Float[Array, ""] = eqx.field(converter=real)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(True,))

    def __check_init__(self) -> None:
        nonnegative("decay", self.decay)

    def initial(self) -> PyTree:
        """At rest, at angle zero."""
        return at_rest(self.decay, [0.0])

    def inertia(self, q: RealArray) -> RealArray:
        return jnp.ones((1, 1), q.dtype)

    def potential(self, q: RealArray) -> RealArray:
        return jnp.zeros_like(q[0])

    def input_matrix(self, q: RealArray) -> RealArray:
        del q
        return self.gain[None, None]

    def friction(self, q: RealArray) -> RealArray:
        del q
        return self.decay[None, None]


class CartOnArm(AbstractMechanicalSystem):
    """A cart that slides along a rotating arm, in a vertical plane or, without gravity, a
    horizontal one: `q = (distance from the pivot (m), angle of the arm (rad))`,
    `M = diag(mass, inertia_arm + mass q1^2)`, `V = mass gravity q1 sin q2`. Input: the
    force on the cart (N) and the torque on the arm (N m).

    - `mass` (kg) of the cart, `inertia_arm` (kg m^2), `gravity` (m/s^2);
    - `damping`: constant friction of each coordinate, shape `(2,)`.
    """

    mass: Float[Array, ""] = eqx.field(converter=real)
    inertia_arm: Float[Array, ""] = eqx.field(converter=real)
    gravity: Float[Array, ""] = eqx.field(converter=real, default=0.0)
    damping: Float[Array, " 2"] = none_of(2)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(False, True))

    def __check_init__(self) -> None:
        positive("mass", self.mass, "kg")
        positive("inertia_arm", self.inertia_arm, "kg m^2")
        nonnegative("damping", self.damping)

    def initial(self) -> PyTree:
        """At rest, half a metre out, the arm level."""
        return at_rest(self.mass, [0.5, 0.0])

    def inertia(self, q: RealArray) -> RealArray:
        arm = self.inertia_arm + self.mass * q[0] ** 2
        return jnp.diag(jnp.stack([self.mass, arm]))

    def potential(self, q: RealArray) -> RealArray:
        return self.mass * self.gravity * q[0] * jnp.sin(q[1])

    def input_matrix(self, q: RealArray) -> RealArray:
        return jnp.eye(2, dtype=q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        return jnp.diag(self.damping)


class InertiaWheelPendulum(AbstractMechanicalSystem):
    """A pendulum with a driven wheel at its end: `q = (angle of the pendulum from the
    upright (rad), angle of the wheel in space (rad))`, `M = diag(inertia_pendulum,
    inertia_wheel)`, `V = weight cos q1`. Input: the torque on the wheel (N m), which acts
    back on the pendulum.

    - `inertia_pendulum` (kg m^2) with the mass of the wheel; `inertia_wheel` (kg m^2);
    - `weight` (N m): mass times gravity times distance of the centre of mass;
    - `damping`: constant friction (N m s/rad) of the pendulum at its pivot and of the wheel
      at its axle, shape `(2,)`; the latter acts between wheel and pendulum.

    Source: Spong, Corke, Lozano, Automatica 37 (2001) 1845-1851.
    """

    inertia_pendulum: Float[Array, ""] = eqx.field(converter=real)
    inertia_wheel: Float[Array, ""] = eqx.field(converter=real)
    weight: Float[Array, ""] = eqx.field(converter=real)
    damping: Float[Array, " 2"] = none_of(2)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(True, True))

    def __check_init__(self) -> None:
        positive("inertia_pendulum", self.inertia_pendulum, "kg m^2")
        positive("inertia_wheel", self.inertia_wheel, "kg m^2")
        nonnegative("damping", self.damping)

    def initial(self) -> PyTree:
        """Hanging, at rest."""
        return at_rest(self.weight, [jnp.pi, 0.0])

    def inertia(self, q: RealArray) -> RealArray:
        return jnp.diag(jnp.stack([self.inertia_pendulum, self.inertia_wheel]))

    def potential(self, q: RealArray) -> RealArray:
        return self.weight * jnp.cos(q[0])

    def input_matrix(self, q: RealArray) -> RealArray:
        return jnp.asarray([[-1.0], [1.0]], q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        pivot, axle = self.damping
        return jnp.stack([jnp.stack([pivot + axle, -axle]), jnp.stack([-axle, axle])])


class VariableLengthPendulum(AbstractMechanicalSystem):
    """A pendulum whose length is driven: `q = (length (m), angle from hanging (rad))`,
    `M = diag(mass, mass q1^2)`, `V = -mass gravity q1 cos q2`. Input: the force along the
    pendulum (N), outward. The length must stay positive.

    - `mass` (kg), `gravity` (m/s^2);
    - `damping`: constant friction of each coordinate, shape `(2,)`.
    """

    mass: Float[Array, ""] = eqx.field(converter=real)
    gravity: Float[Array, ""] = eqx.field(converter=real, default=9.81)
    damping: Float[Array, " 2"] = none_of(2)
    angles: tuple[bool, ...] = eqx.field(static=True, default=(False, True))

    def __check_init__(self) -> None:
        positive("mass", self.mass, "kg")
        nonnegative("damping", self.damping)

    def initial(self) -> PyTree:
        """At rest, 1 m long, 0.3 rad from hanging."""
        return at_rest(self.mass, [1.0, 0.3])

    def inertia(self, q: RealArray) -> RealArray:
        return jnp.diag(jnp.stack([self.mass, self.mass * q[0] ** 2]))

    def potential(self, q: RealArray) -> RealArray:
        return -self.mass * self.gravity * q[0] * jnp.cos(q[1])

    def input_matrix(self, q: RealArray) -> RealArray:
        return jnp.asarray([[1.0], [0.0]], q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        return jnp.diag(self.damping)


def at_rest(like: Array, position: list[float]) -> MechanicalState:
    """At rest at `position`, in the precision of `like`."""
    q = jnp.asarray(position, like.dtype)
    return MechanicalState(q, jnp.zeros_like(q))
