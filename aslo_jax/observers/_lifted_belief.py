"""The belief of the Kalman filter of a lifted relation."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from .._factored import Factors, Rows, covariance, unpacked
from ._lifting import entries


class LiftedBelief(NamedTuple):
    """Mean, shape `(N,)`, and factors of the covariance, of the lifted state: sigma of each
    row that has one, then x. `unsteady`, shape `(r,)`: over how many samples noise of the
    input has gathered in the row of each sigma."""

    mean: Float[Array, " N"]
    factors: Factors
    unsteady: Float[Array, " r"]


class Lists(NamedTuple):
    """A belief taken apart, of r states sigma and x."""

    r: int
    mean: list[Any]
    U: Rows
    d: list[Any]
    unsteady: list[Any]

    @property
    def x(self) -> list[Any]:
        return self.mean[self.r :]

    def spread(self) -> Rows:
        """The covariance of x."""
        return covariance(self.U, self.d, self.r)


def lists_of(X: LiftedBelief) -> Lists:
    U, d = unpacked(X.factors)
    return Lists(X.unsteady.shape[0], entries(X.mean), U, d, entries(X.unsteady))
