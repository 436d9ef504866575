"""The extended Kalman filter, its Jacobians by automatic differentiation."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._checks import is_concrete, positive, real
from .._filters import AbstractLaw
from .._realise import Pass
from .._runge_kutta import runge_kutta
from .._small import safe_reciprocal, solve_definite
from .._typing import PyTree, RealArray
from ..plants import (
    AbstractMachine,
    AbstractMechanicalSystem,
    AbstractVectorPlant,
    FluxRelation,
)
from ._base import AbstractObserver, Estimate
from ._lifted_filter import grown, hole_of
from ._missing import DOUBT
from ._models import AbstractModel, MechanicalModel, PMSMModel
from ._plant_model import MachineModel, PlantModel

__all__ = ["Belief", "ExtendedKalman"]


class Belief(NamedTuple):
    """The `mean`, shape `(n,)`, and the `covariance`, shape `(n, n)`, of the state."""

    mean: Float[Array, " n"]
    covariance: Float[Array, "n n"]


class _KalmanBucy(AbstractLaw):
    """The belief, driven by `(u, y)`: Riccati's equation in continuous time; sampled, a
    prediction over the interval with u held, and an update by the y at its end, or where
    `trust` is zero none. `lost`, where inputs may be missing, is what the square of their
    length is to be multiplied by for the variance of each of them over the interval."""

    model: AbstractModel
    process: Float[Array, "n n"]
    measurement: Float[Array, "p p"]
    trust: Float[Array, ""] | float = 1.0
    lost: Float[Array, ""] | None = None

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        (u, y), (x, P) = v, X
        A = jax.jacfwd(self.model.drift)(x, u)
        H = jax.jacfwd(self.model.output)(x)
        PHt = P @ H.T
        gain = self.trust * _divide(PHt, self.measurement)
        rate = self.model.drift(x, u) + gain @ (y - self.model.output(x))
        AP = A @ P
        return Belief(rate, AP + AP.T + self.process - gain @ PHt.T)

    def discretise(self, h: RealArray | float) -> PyTree:
        return jnp.asarray(h, self.process.dtype)

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        h, (u, _), (_, y) = coefficients, v0, v1
        predict = lambda x: runge_kutta(lambda t, x: self.model.drift(x, u), 0.0, x, h)
        x, transition = predict(X.mean), jax.jacfwd(predict)(X.mean)
        # Noise enters throughout the interval: the trapezoidal rule of its integral.
        half = 0.5 * h * self.process
        before = X.covariance + half
        if self.lost is not None:
            entries, back = ravel_pytree(u)
            by_u = jax.jacfwd(lambda v: self.model.drift(X.mean, back(v)))(entries)
            before = before + h**2 * self.lost * jnp.sum(entries**2) * (by_u @ by_u.T)
        P = transition @ before @ transition.T + half
        H = jax.jacfwd(self.model.output)(x)
        V = self.measurement / h
        gain = self.trust * _divide(P @ H.T, H @ P @ H.T + V)
        # Joseph's form: symmetric, and definite whatever rounding does to the gain.
        rest = jnp.eye(x.shape[0], dtype=x.dtype) - gain @ H
        P = rest @ P @ rest.T + gain @ V @ gain.T
        return Belief(x + gain @ (y - self.model.output(x)), P)


class Pending(AbstractLaw):
    """The variance of the estimate before a hole until it has come back, or is small beside
    the estimate; 0 where there is none. Driven by whether a sample is missing, the variance
    and the square of the estimate."""

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return jnp.zeros_like(X)

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        (_, before, _), (missing, variance, square) = v0, v1
        begun = jnp.where(X > 0.0, X, before)
        back = variance <= jnp.maximum(BACK * X, DOUBT**2 * square)
        return jnp.where(missing > 0.0, begun, jnp.where(back, 0.0, X))


BACK = 4.0  # times the variance before a hole: twice the deviation


class ExtendedKalman(AbstractObserver):
    """The extended Kalman filter of a model with white noise.

    - `model`: `drift(x, u)`, `output(x)`, and what of x is the estimate, `select(x)`;
    - `process`, shape `(n, n)`: the two-sided intensity of the noise on x' (unit of x
      squared per second);
    - `measurement`, shape `(p, p)`: that of the noise on y (unit of y squared times
      second). A noise of covariance C on samples `dt` seconds apart has intensity `C dt`;
    - `initial`, shape `(n,)`, and `covariance`, shape `(n, n)`: the first belief.

    In continuous time it is the Kalman-Bucy filter linearised at the estimate. Sampled, it
    predicts over the interval with the held input (Runge and Kutta's fourth-order step and
    its exact Jacobian) and updates at the sample. Where samples are missing it predicts; of
    an input that is held in the place of a missing one nothing is taken to be known, and
    after the hole the estimate is flagged as coasting until its deviation is twice that
    before at most, or 5 % of the estimate.

    The certificate is the part of the first variance that has been removed, of the entry of
    the estimate where it is least: between 0 and 1. It is what the linearised filter
    believes, which from a wide first belief may be wrong: a PMSM at rest is then taken to
    be known.

    Source: Kalman and Bucy 1961, doi:10.1115/1.3658902; Jazwinski, Stochastic Processes
    and Filtering Theory, 1970, theorem 8.1.

    **Raises:** `ValueError` for a matrix that is not symmetric and positive (semi)definite.
    """

    model: AbstractModel
    process: Float[Array, "n n"] = eqx.field(converter=real)
    measurement: Float[Array, "p p"] = eqx.field(converter=real)
    initial: Float[Array, " n"] = eqx.field(converter=real)
    covariance: Float[Array, "n n"] = eqx.field(converter=real)

    def __check_init__(self) -> None:
        for name in ("process", "measurement", "covariance"):
            value = getattr(self, name)
            if not isinstance(value, jax.Array) or not is_concrete(value):
                continue  # a placeholder of a tree transformation, or traced
            least = float(jnp.linalg.eigvalsh(0.5 * (value + value.T)).min())
            regular = least > 0 if name == "measurement" else least >= -1e-12
            if not (regular and jnp.allclose(value, value.T)):
                kind = "definite" if name == "measurement" else "semidefinite"
                raise ValueError(
                    f"Argument `{name}` must be a symmetric positive {kind} matrix, but "
                    f"its least eigenvalue is {least:.6g}."
                )

    @classmethod
    def of_pmsm(
        cls,
        relation: FluxRelation,
        voltage: Float[Array, ""] | float,
        acceleration: Float[Array, ""] | float,
        current: Float[Array, ""] | float,
        speed_deviation: Float[Array, ""] | float = 100.0,
        initial: Float[Array, " 4"] | None = None,
    ) -> "ExtendedKalman":
        """For a PMSM ([`PMSMModel`][]), from the two-sided intensities of the noise on the
        `voltage` (V^2 s), of the electrical `acceleration` (rad^2/s^3) and of the noise on
        the `current` (A^2 s). Without `initial` the first belief is the magnet flux along
        the first axis at standstill, known to no better than its size, half a turn of the
        angle, and `speed_deviation` (rad/s) of the electrical speed.
        """
        voltage, acceleration, current = map(real, (voltage, acceleration, current))
        for name, value in (
            ("voltage", voltage),
            ("acceleration", acceleration),
            ("current", current),
        ):
            positive(name, value)
        positive("relation.magnet_flux", relation.magnet_flux, "Wb")
        m, zero = relation.magnet_flux, jnp.zeros_like(relation.magnet_flux)
        if initial is None:
            initial = jnp.stack([m, zero, zero, zero])
        process = jnp.stack([voltage, voltage, acceleration, jnp.zeros_like(voltage)])
        spread = jnp.stack([m, m, zero + speed_deviation, zero + jnp.pi])
        return cls(
            PMSMModel(relation),
            jnp.diag(process),
            current * jnp.eye(2, dtype=current.dtype),
            initial,
            jnp.diag(spread**2),
        )

    @classmethod
    def of_mechanical(
        cls,
        system: AbstractMechanicalSystem,
        acceleration: Float[Array, "*n"] | float,
        position: Float[Array, "*n"] | float,
        velocity_deviation: Float[Array, "*n"] | float = 10.0,
        *,
        initial: Float[Array, " n"],
    ) -> "ExtendedKalman":
        """For the velocities of a mechanical system ([`MechanicalModel`][]), from the
        two-sided intensities of the noise on each `acceleration` (m^2/s^3 or rad^2/s^3) and
        `position` (m^2 s or rad^2 s), shape `()` or `(n,)`. The first belief is the
        position `initial`, known to a thousandth of `velocity_deviation` times a second, at
        rest with `velocity_deviation` (m/s or rad/s)."""
        initial = real(initial)
        acceleration, position = real(acceleration), real(position)
        positive("acceleration", acceleration)
        positive("position", position)
        whole = lambda x: jnp.broadcast_to(real(x), initial.shape)
        zero, spread = jnp.zeros_like(initial), whole(velocity_deviation)
        return cls(
            MechanicalModel(system),
            jnp.diag(jnp.concatenate([zero, whole(acceleration)])),
            jnp.diag(whole(position)),
            jnp.concatenate([initial, zero]),
            jnp.diag(jnp.concatenate([1e-3 * spread, spread]) ** 2),
        )

    @classmethod
    def of_plant(
        cls,
        plant: AbstractVectorPlant,
        process: Float[Array, ""] | float,
        drift: Float[Array, ""] | float,
        measurement: Float[Array, "*p"] | float,
        initial: Float[Array, " s"] | None = None,
    ) -> "ExtendedKalman":
        """For a plant and its unknown parameters ([`PlantModel`][]), from two-sided
        intensities: `process` of the noise on the rate of every state, over the square of
        half of its range (1/s); `drift` of that on every unknown parameter, over the square
        of half of its value (1/s); `measurement` of that on the outputs, in their units
        squared times second, shape `()` or `(p,)`. The first belief is the state
        `initial`, shape `(s,)`, by default the plant's own, and the plant's own parameters,
        each known to half of its range or value."""
        process, drift, measurement = map(real, (process, drift, measurement))
        for name, value in (
            ("process", process),
            ("drift", drift),
            ("measurement", measurement),
        ):
            positive(name, value)
        model, n = PlantModel(plant), len(plant.states)
        x = model.joined(plant.initial() if initial is None else real(initial))
        square = model.spans().astype(x.dtype) ** 2
        constant = (jnp.arange(x.size) >= n) & (jnp.arange(x.size) < n + len(plant.unknown))
        return cls(
            model,
            jnp.diag(square * jnp.where(constant, drift, process)),
            jnp.diag(jnp.broadcast_to(measurement, (len(plant.outputs),))),
            x,
            jnp.diag(square),
        )

    @classmethod
    def of_machine(
        cls,
        machine: AbstractMachine,
        voltage: Float[Array, ""] | float,
        acceleration: Float[Array, ""] | float,
        current: Float[Array, ""] | float,
        *,
        flux: Float[Array, " n"],
        speed_deviation: Float[Array, ""] | float = 100.0,
    ) -> "ExtendedKalman":
        """For any electrical machine ([`MachineModel`][]), from the two-sided intensities
        of the noise on the `voltage` (V^2 s), of the electrical `acceleration` (rad^2/s^3)
        and of the noise on the `current` (A^2 s). The first belief is the `flux` (Wb),
        shape `(n,)`, at angle zero and standstill, known to no better than its size, half a
        turn of the angle, and `speed_deviation` (rad/s) of the electrical speed."""
        voltage, acceleration, current = map(real, (voltage, acceleration, current))
        for name, value in (
            ("voltage", voltage),
            ("acceleration", acceleration),
            ("current", current),
        ):
            positive(name, value)
        flux = real(flux)
        n, zero = flux.size, jnp.zeros(2, flux.dtype)
        size = jnp.sqrt(jnp.sum(flux**2))
        spread = jnp.stack([*[size] * n, zero[0] + speed_deviation, zero[0] + jnp.pi])
        process = jnp.stack([*[voltage] * n, acceleration, zero[0]])
        return cls(
            MachineModel(machine),
            jnp.diag(process),
            current * jnp.eye(n, dtype=current.dtype),
            jnp.concatenate([flux, zero]),
            jnp.diag(spread**2),
        )

    @property
    def signals(self) -> dict[str, tuple[int, ...]]:
        return self.model.signals_of(self.initial.shape[0])

    def belief(self, F: Pass, u: PyTree, y: PyTree) -> Belief:
        """Mean and covariance of the whole state."""
        u, y = jax.tree.map(jnp.asarray, u), jnp.atleast_1d(y)
        hole = hole_of(F, self.initial.dtype, blind=True)
        lost = None if hole is None else grown(hole)
        law = _KalmanBucy(self.model, self.process, self.measurement, F.trust, lost)
        start = Belief(self.initial, self.covariance)
        return F.evolve(law, (u, y), start, "belief")

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Estimate:
        x, P = self.belief(F, u, y)
        J = jax.jacfwd(self.model.select)(x)
        variance, first = (jnp.sum((J @ C) * J, axis=1) for C in (P, self.covariance))
        certificate = jnp.min(1.0 - variance * safe_reciprocal(first))
        value = self.model.select(x)
        total = jnp.sum(variance)
        drive = F.missing.astype(total.dtype), total, jnp.sum(value**2)
        pending = F.evolve(Pending(), drive, jnp.zeros_like(total), "pending")
        return Estimate(value, jnp.clip(certificate, 0.0, 1.0), pending > 0.0)


def _divide(B: Float[Array, "n p"], S: Float[Array, "p p"]) -> Float[Array, "n p"]:
    """`B S^-1` for a positive definite S."""
    return jnp.stack([solve_definite(S, row)[0] for row in B])
