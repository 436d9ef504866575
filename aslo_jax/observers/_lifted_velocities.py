"""One Kalman filter of all velocities of a mechanical system."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import kind, optional_real, positive, real
from .._factored_arrays import covariance, unpacked
from .._guard import Guard
from .._realise import Pass
from .._typing import PyTree
from ..plants import AbstractMechanicalSystem
from ._base import AbstractObserver, Estimate, check_initial
from ._extended_kalman import Pending
from ._lifted_filter import grown, hole_of
from ._mechanical_belief import Deviations, MechanicalBelief
from ._mechanical_filter import MechanicalKalman
from ._motion import Motion
from ._unwrapped import continued_angles

POSITIVE = "output_deviation", "input_deviation", "force_deviation", "prior", "interval"


def numbers(x: Any) -> Any:
    """A list is one array; `None` stays that."""
    return real(jnp.asarray(x)) if isinstance(x, list | tuple) else optional_real(x)


class LiftedVelocities(AbstractObserver):
    """The Kalman filter of all velocities of a mechanical system at once, from its
    positions: the best estimate from noisy samples, where the model is right. There is no
    filter to be chosen, and nothing has to be known of the velocities at the start.

    The rate relations of all coordinates ([`MomentumRelation`][]), each with the position
    that it measures as one more state, as [`Lifted`][] has it, are together the equations
    of motion in the positions and the velocities, and this is the filter of them: what one
    velocity tells of another goes both ways, where a [`velocity_observer`][] takes earlier
    stages as exact, and forces are taken at the filtered positions, not at the samples. So
    it needs none of the structure that [`structure_of`][] looks for. The motion is taken as
    linear over one interval, about the mean; where the two positions at its ends tell the
    velocity better, as they do at the start, about their difference. What is left of any
    start is therefore no more than what rounding of two samples leaves.

    - `system`: the mechanical system, whose angles are unwrapped on the way in;
    - `output_deviation`, `input_deviation`: standard deviations of white noise on every
      sample of the positions (m, rad), shape `()` or `(n,)`, and of the forces in u (N,
      N m), shape `()` or `(m,)`. Of an encoder that is its step over `sqrt(12)`;
    - `force_deviation`: that of forces on each coordinate that the model does not know,
      white, in each interval (N, N m), shape `()` or `(n,)`; by default there are none, and
      the longer the log the more the model is believed;
    - `prior`: the standard deviation of the first velocities (m/s, rad/s), shape `()` or
      `(n,)`; by default nothing is known of them;
    - `initial`: their mean, shape `(n,)`; zero by default;
    - `guard`: below its threshold the certificate flags the estimate as coasting; `None`
      flags nothing but missing samples;
    - `interval`: in continuous time, of the samples (s) that the deviations belong to.

    The estimate has the `covariance` of the velocities, shape `(n, n)`. Its certificate is
    `1/(1 + r)`, r the largest variance of a velocity beside that of the first belief, as
    that of [`Lifted`][]. Over samples that are missing it is carried along by the model.
    After them it is flagged until its deviation is at most twice what it was before, or
    5 % of the estimate.

    Source: theory, sections 5 and 10; Kalman 1960, doi:10.1115/1.3662552; Bierman 1977.

    **Raises:** `ValueError` for a deviation that is not positive or of another shape, in
    continuous time without an `interval`, and for an `initial` whose shape is not that of
    the positions.
    """

    system: AbstractMechanicalSystem
    output_deviation: Float[Array, "*n"] = eqx.field(converter=numbers)
    input_deviation: Float[Array, "*m"] = eqx.field(converter=numbers)
    force_deviation: Float[Array, "*n"] | None = eqx.field(converter=numbers, default=None)
    prior: Float[Array, "*n"] | None = eqx.field(converter=numbers, default=None)
    initial: Float[Array, " n"] | None = eqx.field(converter=numbers, default=None)
    guard: Guard | None = eqx.field(default_factory=lambda: Guard(0.9))
    interval: Float[Array, ""] | None = eqx.field(converter=optional_real, default=None)

    def __check_init__(self) -> None:
        check_system(self)

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return signals_of(self.system)

    def continued(self, before: PyTree, y: PyTree) -> Any:
        return unwrapped(self.system, before, y)

    def law(self, u: Float[Array, " m"], y: Float[Array, " n"]) -> MechanicalKalman:
        """The filter itself, for signals like u and y."""
        return law_of(self, motion_of(self, y), jnp.zeros(0, y.dtype), None, u, y)

    def vector_field(self, t: Any, state: Any, u: PyTree, y: PyTree) -> Any:
        check_interval(self.interval)
        return super().vector_field(t, state, u, y)

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        law = self.law(u, y)
        value, certificate, pending, P, _ = judged(F, law, u, y)
        flagged = pending | unknown(self.guard, certificate)
        return Estimate(value, certificate, flagged, P)


def check_system(observer: Any) -> None:
    """Refuse what is no system, and deviations that are not positive."""
    hint = "a mechanical system, such as `MechanicalSystem`"
    kind("system", observer.system, AbstractMechanicalSystem, hint=hint)
    for name in POSITIVE:
        value = getattr(observer, name)
        if value is not None:
            positive(name, value)
    kind("guard", observer.guard, Guard, hint="a `Guard` or `None`")


def check_interval(interval: Any) -> None:
    """Refuse continuous time without an interval."""
    if interval is None:
        raise ValueError(
            "Argument `interval` must be given in continuous time, but got None: the "
            "deviations are those of samples, so many seconds apart."
        )


def unknown(guard: Guard | None, certificate: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether the velocities are not known yet."""
    return jnp.asarray(False) if guard is None else ~guard.certified(certificate)


def signals_of(system: AbstractMechanicalSystem) -> dict[str, tuple[int, ...]]:
    """The shapes of u and y."""
    n = jax.eval_shape(lambda: system.initial().position).shape[0]
    return system.signals_of(n)


def unwrapped(system: AbstractMechanicalSystem, before: Array, y: Array) -> Array:
    """y with its angles unwrapped after those of the sample `before`."""
    angles = system.angles
    return continued_angles(before, y, jnp.asarray(angles)) if any(angles) else y


def motion_of(
    observer: Any, y: Float[Array, " n"], parameters: tuple[str, ...] = ()
) -> Motion:
    """The motion of the system of an observer, some of its parameters unknown."""
    forces = observer.force_deviation is not None
    return Motion(observer.system, y.shape[0], parameters, forces)


def law_of(
    observer: Any,
    motion: Motion,
    parameters: Float[Array, " k"],
    drift: Float[Array, " k"] | None,
    u: Float[Array, " m"],
    y: Float[Array, " n"],
) -> MechanicalKalman:
    """The filter of an observer with the deviations of its unknown parameters and their
    random walk."""
    if observer.initial is not None:
        check_initial(observer.initial, y)
    prior = jnp.finfo(y.dtype).eps ** -0.5 if observer.prior is None else observer.prior
    force = observer.force_deviation
    deviations = Deviations(
        whole("output_deviation", observer.output_deviation, y),
        whole("input_deviation", observer.input_deviation, u),
        None if force is None else whole("force_deviation", force, y),
        whole("prior", jnp.asarray(prior), y),
        parameters,
        drift,
    )
    return MechanicalKalman(motion, deviations, observer.initial, observer.interval)


def whole(name: str, value: Array, like: Array) -> Array:
    """A `value` for each entry of something, from one number for all or one for each."""
    if jnp.shape(value) not in ((), jnp.shape(like)):
        raise ValueError(
            f"Argument `{name}` must be a number or have the shape {jnp.shape(like)}, but "
            f"got {jnp.shape(value)}."
        )
    return jnp.broadcast_to(value, jnp.shape(like)).astype(like.dtype)


def judged(
    F: Pass, law: MechanicalKalman, u: Array, y: Array
) -> tuple[Array, Array, Bool[Array, ""], Float[Array, "n n"], MechanicalBelief]:
    """The velocities, their certificate, whether they are flagged after missing samples,
    their covariance, and the whole belief."""
    n, dtype = y.shape[0], y.dtype
    hole = hole_of(F, dtype, blind=True)
    if hole is not None:
        trust = jnp.asarray(F.trust, dtype)
        law = dataclasses.replace(law, trust=trust, lost=grown(hole))
    belief = F.evolve(law, (u, y), law.start(y), "belief")
    U = unpacked(belief.factors)
    P = covariance(U[n : 2 * n], belief.factors.pivots)
    value, variances = belief.mean[n : 2 * n], jnp.diagonal(P)
    worst = jnp.max(variances / law.deviations.velocity**2)
    total = jnp.sum(variances)
    drive = F.missing.astype(dtype), total, jnp.sum(value**2)
    pending = F.evolve(Pending(), drive, jnp.zeros_like(total), "pending") > 0.0
    return value, 1.0 / (1.0 + worst), pending, P, belief
