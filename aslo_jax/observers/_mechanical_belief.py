"""What the Kalman filter of a mechanical system believes, and what it is given."""

from typing import NamedTuple

from jaxtyping import Array, Float

from .._factored import Factors


class MechanicalBelief(NamedTuple):
    """Mean, shape `(N,)`, and factors of the covariance, of positions, velocities and
    unknown parameters."""

    mean: Float[Array, " N"]
    factors: Factors


class Deviations(NamedTuple):
    """Standard deviations: of the noise on every sample of y, shape `(n,)`, of u, shape
    `(m,)`, and of forces that are not in u, shape `(n,)`, or `None`; of the first
    belief of the velocities, shape `(n,)`, and of the parameters, shape `(k,)`; and of
    their random walk after a second, shape `(k,)`, or `None`."""

    output: Float[Array, " n"]
    input: Float[Array, " m"]
    force: Float[Array, " n"] | None
    velocity: Float[Array, " n"]
    parameters: Float[Array, " k"]
    drift: Float[Array, " k"] | None
