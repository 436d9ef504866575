"""Mechanical systems (paper, section 4.3), their velocities hidden."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._module import Module
from .._relations import contract
from .._small import solve_definite
from .._typing import PyTree, RealArray
from ._base import AbstractPlant

__all__ = ["AbstractMechanicalSystem", "MechanicalState", "MechanicalSystem", "solve"]


class MechanicalState(Module):
    """`position`: the generalised coordinates q (rad or m, angles unwrapped), and
    `velocity`: their derivatives, each of shape `(n,)`."""

    position: Float[Array, " n"]
    velocity: Float[Array, " n"]


class AbstractMechanicalSystem(AbstractPlant):
    """`M(q) q'' + C(q, q') q' + R(q) q' + grad V(q) = G(q) u`: input u the generalised
    forces, shape `(m,)`, output the coordinates q, shape `(n,)`, hidden part their
    derivatives. SI units: a coordinate is in m or rad, its force in N or N m.

    M, V, G and R are given; the Coriolis forces, `C q' = M' q' - 1/2 grad(q'M q')`, come
    from them by automatic differentiation.

    - `angles`: for each coordinate, whether it is an angle (rad), which encoders wrap;
      it may be empty where none is.

    Source: paper, eqs. (EL) and (Cor).
    """

    angles: eqx.AbstractVar[tuple[bool, ...]]

    @abc.abstractmethod
    def inertia(self, q: Float[Array, " n"]) -> Float[Array, "n n"]:
        """`M(q)`, symmetric and positive definite, shape `(n, n)`."""

    @abc.abstractmethod
    def potential(self, q: Float[Array, " n"]) -> Float[Array, ""]:
        """`V(q)` (J)."""

    @abc.abstractmethod
    def input_matrix(self, q: Float[Array, " n"]) -> Float[Array, "n m"]:
        """`G(q)`, shape `(n, m)`."""

    @abc.abstractmethod
    def friction(self, q: Float[Array, " n"]) -> Float[Array, "n n"]:
        """`R(q)`, symmetric and positive semidefinite, shape `(n, n)`."""

    def lagrangian(
        self, q: Float[Array, " n"], velocity: Float[Array, " n"]
    ) -> Float[Array, ""]:
        """`1/2 q'M(q) q' - V(q)` (J)."""
        momentum = contract(self.inertia(q), velocity)
        return 0.5 * jnp.sum(velocity * momentum) - self.potential(q)

    def force(
        self, q: Float[Array, " n"], velocity: Float[Array, " n"], u: Float[Array, " m"]
    ) -> Float[Array, " n"]:
        """The derivative of the momenta `M q'` but for friction: `grad_q` of the
        Lagrangian, and `G u`."""
        return jax.grad(self.lagrangian)(q, velocity) + contract(self.input_matrix(q), u)

    def acceleration(
        self, q: Float[Array, " n"], velocity: Float[Array, " n"], u: Float[Array, " m"]
    ) -> Float[Array, " n"]:
        """`q''` of the model."""
        momentum = lambda q: contract(self.inertia(q), velocity)
        _, turning = jax.jvp(momentum, (q,), (velocity,))
        force = self.force(q, velocity, u) - turning
        net = force - contract(self.friction(q), velocity)
        return solve(self.inertia(q), net)

    def energy(self, x: MechanicalState) -> Float[Array, ""]:
        """Kinetic and potential energy (J)."""
        kinetic = self.lagrangian(x.position, x.velocity) + self.potential(x.position)
        return kinetic + self.potential(x.position)

    def signals_of(self, coordinates: int) -> dict[str, tuple[int, ...]]:
        """The shapes of u and y for so many coordinates."""
        q = jax.ShapeDtypeStruct((coordinates,), jnp.result_type(float))
        return {"u": jax.eval_shape(self.input_matrix, q).shape[1:], "y": q.shape}

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        del t
        return MechanicalState(x.velocity, self.acceleration(x.position, x.velocity, u))

    def output(self, x: PyTree) -> PyTree:
        return x.position

    def hidden(self, x: PyTree) -> RealArray:
        return x.velocity

    def no_input(self, y: PyTree) -> PyTree:
        return jnp.zeros_like(self.input_matrix(y)[0])


class MechanicalSystem(AbstractMechanicalSystem):
    """A mechanical system from plain functions of q, shape `(n,)`.

    - `inertia(q)`: M, shape `(n, n)`, or `(n,)` for its diagonal;
    - `potential(q)`: V (J), shape `()`; by default none;
    - `input_matrix(q)`: G, shape `(n, m)`; by default the identity;
    - `friction(q)`: R, shape `(n, n)`, or `(n,)` for its diagonal; by default none;
    - `position`: the coordinates at the first instant, shape `(n,)`; at rest there;
    - `angles`: for each coordinate, whether it is an angle (rad); by default none is.

    A function can be an `equinox.Module` with parameters of its own, which are then
    differentiable leaves of the system.

    **Raises:** `ValueError` for a `position`, `angles` or a function's result whose shape
    does not fit the coordinates.
    """

    _inertia: Callable[[Float[Array, " n"]], Array]
    _potential: Callable[[Float[Array, " n"]], Array] | None
    _input_matrix: Callable[[Float[Array, " n"]], Array] | None
    _friction: Callable[[Float[Array, " n"]], Array] | None
    position: Float[Array, " n"]
    angles: tuple[bool, ...] = eqx.field(static=True)

    def __init__(
        self,
        inertia: Callable[[Float[Array, " n"]], Array],
        potential: Callable[[Float[Array, " n"]], Array] | None = None,
        input_matrix: Callable[[Float[Array, " n"]], Array] | None = None,
        *,
        position: PyTree,
        friction: Callable[[Float[Array, " n"]], Array] | None = None,
        angles: tuple[bool, ...] = (),
    ) -> None:
        self._inertia = inertia
        self._potential = potential
        self._input_matrix = input_matrix
        self._friction = friction
        self.position = jnp.asarray(position, float)
        self.angles = tuple(map(bool, angles))

    def __check_init__(self) -> None:
        q = self.position
        if not isinstance(q, jax.Array):
            return  # a placeholder of a tree transformation
        if q.ndim != 1:
            raise ValueError(
                "Argument `position` must have the shape (n,) of the coordinates, but got "
                f"{q.shape}."
            )
        n = q.shape[0]
        if len(self.angles) not in (0, n):
            raise ValueError(
                f"Argument `angles` must have one entry for each of the {n} coordinates, "
                f"but got {len(self.angles)}."
            )
        square = ((n, n), (n,))
        checks = {
            "inertia": (self._inertia, square),
            "potential": (self._potential, ((),)),
            "friction": (self._friction, square),
        }
        for name, (function, shapes) in checks.items():
            if function is not None:
                found = jax.eval_shape(lambda q, f=function: jnp.asarray(f(q)), q).shape
                if found not in shapes:
                    allowed = " or ".join(map(str, shapes))
                    raise ValueError(
                        f"Argument `{name}` must return the shape {allowed} for {n} "
                        f"coordinates, but it returns {found}."
                    )
        G = jax.eval_shape(self.input_matrix, q).shape
        if len(G) != 2 or G[0] != n:
            raise ValueError(
                f"Argument `input_matrix` must return the shape ({n}, m) for {n} "
                f"coordinates, but it returns {G}."
            )

    def initial(self) -> PyTree:
        return MechanicalState(self.position, jnp.zeros_like(self.position))

    def inertia(self, q: RealArray) -> RealArray:
        return _matrix(self._inertia(q))

    def potential(self, q: RealArray) -> RealArray:
        if self._potential is None:
            return jnp.zeros_like(q[0])
        return jnp.asarray(self._potential(q), q.dtype)

    def input_matrix(self, q: RealArray) -> RealArray:
        if self._input_matrix is None:
            return jnp.eye(q.shape[0], dtype=q.dtype)
        return jnp.asarray(self._input_matrix(q), q.dtype)

    def friction(self, q: RealArray) -> RealArray:
        if self._friction is None:
            return jnp.zeros((q.shape[0], q.shape[0]), q.dtype)
        return _matrix(self._friction(q))


def _matrix(x: Array) -> Array:
    x = jnp.asarray(x)
    return jnp.diag(x) if x.ndim == 1 else x


def solve(M: Float[Array, "n n"], v: Float[Array, " n"]) -> Float[Array, " n"]:
    """`M^-1 v` for a positive definite M of any size."""
    return solve_definite(M, v)[0]
